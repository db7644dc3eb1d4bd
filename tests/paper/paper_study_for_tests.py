"""A study of one day of the embedded office, put together without the command line."""

from pathlib import Path

from simulation.case import Case, load_case
from studies.console import Console
from studies.paper.size_files import Origin
from studies.paths import ProjectPaths
from studies.profile import load_profile
from studies.stages.pipeline import Study

REPOSITORY = Path(__file__).resolve().parents[2]
RECORDING = REPOSITORY.parent / "shared" / "data" / "office_recording"
ORIGIN = Origin(
    command="studies reproduce-paper office-recorded --budget full --only fig6",
    case="office-recorded",
    case_sha256="0" * 64,
    label="office-recorded-thorough",
    note="",
    budget="full",
    profile="thorough",
    seed=0,
    window_d=(8.0, 16.0),
    unit="K",
    n_validation=320,
    n_test=320,
    versions={},
)


def one_day() -> Case:
    return load_case(REPOSITORY / "fmus" / "office", window_d=(0.0, 1.0))


def study_in(folder: Path, n_jobs: int = 2) -> Study:
    return Study(
        case=one_day(),
        profile=load_profile("smoke"),
        paths=ProjectPaths(folder),
        console=Console(quiet=True),
        n_jobs=n_jobs,
        label="office-paper",
        command="office --profile smoke",
    )

"""The public names of the three packages: each is documented, and each function says what it takes."""

import importlib
import inspect
from pathlib import Path

import pytest

import studies
from studies.cli import build_parser

ROOT = Path(__file__).parents[1]
COMMANDS = {
    "best", "calibrate", "check", "compare", "predict", "report", "reproduce", "run", "sensitivity",
    "simulate", "status", "tune", "uncertainty",
}  # fmt: skip
PUBLIC = {
    "simulation": {
        "Case", "CountingModel", "FmuModel", "ForwardModel", "InputError", "Measurement", "Parameter",
        "ParameterSpace", "PoolModel", "Trajectories", "load_case", "uniform_design",
    },
    "pelsvae": {
        "FitResult", "Surrogate", "SurrogateConfig", "TrainingDiverged", "VARIANTS", "fit", "load_surrogate",
        "save_surrogate",
    },
    "studies": COMMANDS | {
        "BestResult", "CalibrationProblem", "CalibrationResult", "Case", "CheckResult", "ComparisonResult",
        "Console", "InputError", "LeastSquaresTRF", "Measurement", "ObjectiveResult", "PredictionResult",
        "Problem", "ProjectResult", "ReportResult", "ReproductionResult", "RunResult", "SensitivityResult",
        "SimulationResult", "StageError", "TuningResult", "UncertaintyResult", "UnsoundError", "load_case",
    },
}  # fmt: skip


@pytest.mark.parametrize("room", PUBLIC)
def test_public_names_are_pinned_and_in_the_reference(room: str) -> None:
    package = importlib.import_module(room)
    assert set(package.__all__) == PUBLIC[room]
    assert set(dir(package)) >= PUBLIC[room]
    page = (ROOT / "docs" / "reference" / "python.md").read_text("utf-8")
    others = {"Case", "InputError", "Measurement"} if room == "studies" else set()  # simulation's
    for name in package.__all__:
        assert getattr(package, name).__doc__
        assert name in others or f"\n::: {room}.{name}\n" in page
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        package.nothing  # noqa: B018


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_a_function_has_the_keywords_of_its_command(name: str) -> None:
    parameters = inspect.signature(getattr(studies, name)).parameters
    assert not any(one.kind is one.VAR_KEYWORD for one in parameters.values())
    words = {"reproduce": ["x"], "compare": ["x", "y"]}.get(name, [])
    options = vars(build_parser().parse_args([name, *words]))
    # How a result is printed or written to a file is the command line's; in Python the result does that.
    of_the_terminal = {"command", "json", "quiet", "dry_run"}
    if name == "best":
        of_the_terminal |= {"n_train", "experiment", "write"}
    assert parameters.keys() - {"console"} == options.keys() - of_the_terminal
    # A switch that was not given is off; None and False are the same to who reads it.
    defaults = {key: one.default or None for key, one in parameters.items() if key in options}
    assert defaults == {key: options[key] or None for key in defaults} or words

"""Tell the tracking product of an item of the paper, from what lies on disk of it."""

from collections.abc import Sequence
from pathlib import Path

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.stages.pipeline import read_json
from studies.tracking.stage_run import StageRun, log_stage


def tell_item(
    paths: ProjectPaths,
    files: Sequence[Path],
    digest: str,
    *,
    case_digest: str,
    started_s: float,
    wall_s: float,
) -> None:
    """Tell of a finished item, with its numbers, tables and pictures.

    Args:
        paths: the project.
        files: its files, the one with its numbers first.
        digest: digest of the item's inputs.
        case_digest: digest of the case.
        started_s: when it began. [s since 1970, UTC]
        wall_s: its duration. [s]

    Raises:
        InputError: its numbers cannot be read.
    """
    told = read_json(files[0])
    if told is None:
        raise InputError(f"{paths.show(files[0])} cannot be read; type: studies reproduce-paper")
    log_stage(
        paths,
        StageRun(
            label=told["label"],
            kind="paper",
            name=f"paper {told['item']}",
            key=digest,
            params={"budget": told["budget"], "item": told["item"], **told["settings"]},
            metrics={"calls/all": told["n_calls"]["total"], **told.get("metrics", {})},
            tags={"case": told["case"], "case_sha256": case_digest, "agreement": told["agreement"]},
            figures=[file for file in files if file.suffix == ".png"],
            artifacts=[file for file in files if file.suffix != ".png"],
            started_s=started_s,
            wall_s=wall_s,
            note=f"{told['title']}: {told['agreement']}. {told['verdict']}",
        ),
    )

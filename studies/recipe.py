"""Recipes: all that rebuilds a training or a calibration, as JSON values.

A recipe holds the case file's text and names everything else by its SHA-256, so that it can be followed where
the project was moved or changed since, and in another clone.
"""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from studies.stages.pipeline import Study

SCHEMA = 2

Recipe = dict[str, Any]


def recipe_of(study: "Study", kind: str, **more: Any) -> Recipe:
    """Return what rebuilds a result of a study.

    Args:
        study: the study.
        kind: "training", "calibration", "adaptive", "sensitivity" or "uncertainty".
        more: what this kind needs beyond case, profile and seed, as JSON values.
    """
    from simulation.case_reading import read_case_file

    case = study.case
    declared = read_case_file(case.path)
    uses = [("inputs", one.file) for one in declared.inputs] + [
        ("measurement", o.file) for o in declared.outputs
    ]
    roles = {file: dict.fromkeys(role for role, used in uses if used == file) for _, file in uses}
    files = [("fmu", declared.fmu)]
    files += [(" and ".join(role), (Path(declared.data) / name).as_posix()) for name, role in roles.items()]
    return {
        "schema": SCHEMA,
        "kind": kind,
        "command": study.typed,
        "label": study.label,
        "case": {
            "name": case.name,
            "place": study.paths.recorded(case.path),
            "text": case.path.read_text(encoding="utf-8-sig"),
            "sha256": file_digest(case.path),
            "digest": case.digest,
            "model_digest": case.model_digest,
            "measurement_digest": case.measurement.digest,
        },
        "window_d": list(case.window_d),
        "files": [
            {
                "role": role,
                "declared": place,
                "place": study.paths.recorded((case.path.parent / place).resolve()),
                "sha256": file_digest(case.path.parent / place),
            }
            for role, place in files
        ],
        "profile": study.profile.to_dict(),
        "seed": study.profile.seed,
        **more,
    }


def file_digest(file: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

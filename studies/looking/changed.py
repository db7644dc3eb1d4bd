"""Which files a calibration was made from have changed since."""

from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from studies.looking.project import Project, StageLook
from studies.recipe import file_digest, text_digest


def changed_since(project: Project, stage: StageLook) -> tuple[str, ...]:
    """Return the names of the files that a calibration was made from and that hold something else now.

    Of a file that is not here, as in a project that studies were imported into, nothing is said.

    Args:
        project: the project.
        stage: the calibration.
    """
    return tuple(dict.fromkeys(file.name for file, is_same in _files(project, stage) if not is_same))


def _files(project: Project, stage: StageLook) -> Iterator[tuple[Path, bool]]:
    """Yield the files that are here, and whether they are as they were."""
    if not stage.recipe:
        return
    case = stage.recipe["case"]
    made_from = [(case["place"], case["text_sha256"], True)]
    made_from += [(one["place"], one["sha256"], False) for one in stage.recipe["files"]]
    for place, digest, is_text in made_from:
        file = project.paths.root / place
        with suppress(OSError):
            yield file, _digest(file, file.stat().st_mtime_ns, is_text) == digest


@cache
def _digest(file: Path, changed_ns: int, is_text: bool) -> str:
    """Return the digest of a file that was written then; many calibrations are made from one FMU."""
    try:
        return text_digest(file.read_text(encoding="utf-8-sig")) if is_text else file_digest(file)
    except UnicodeDecodeError:
        return ""

"""A label holds the results of one case file: another one of the same name must not replace them."""

from pathlib import Path

from simulation.errors import InputError
from simulation.foreign_file import CASE, parse_toml, read_text
from studies.stages.pipeline import Study, read_json


def refuse_other_case(study: Study) -> None:
    """Refuse a study whose label holds results of another case file that still has this case's name.

    The same file edited in place is no other one, wherever the project was moved: what lies in the project is
    recorded by its place below the root. A file that is gone or was renamed has given its name away.

    Raises:
        InputError: there is such a file.
    """
    case, paths = study.case, study.paths
    for manifest in sorted(study.results.glob("*.json")):
        recorded = (read_json(manifest) or {}).get("case_file")
        other = paths.located(recorded)
        if other is None or other.resolve() == case.path.resolve() or _name_in(other) != case.name:
            continue
        raise InputError(
            f'{paths.show(case.path)}: name = "{case.name}" is also that of {paths.show(other)}, whose '
            f"results {paths.show(study.results)} holds; give one of the two another name, or move that "
            "folder away"
        )


def _name_in(file: Path) -> str | None:
    """Return the name that a case file declares, None where there is none."""
    try:
        name = parse_toml(read_text(file, CASE), str(file)).get("name")
    except InputError:
        return None
    return name if isinstance(name, str) else None

"""What a person may call a study, a trial, a calibration or anything else that a project holds."""

from fnmatch import fnmatchcase

from simulation.errors import InputError
from studies.looking.project import Project
from studies.looking.wording import hint


def chosen_labels(project: Project, which: str | None) -> tuple[str, ...]:
    """Return the labels that a case, a label or a pattern means; all where nothing is named.

    Raises:
        InputError: there is none.
    """
    if which is None or not project.labels:
        return project.labels
    found = tuple(
        label
        for label in project.labels
        if fnmatchcase(label, which) or project.case_of(label) == which or label.startswith(f"{which}-")
    )
    if not found:
        known = ", ".join(project.labels)
        raise InputError(f"nothing is called {which!r}; {hint(which, project.labels)}labels: {known}")
    return found

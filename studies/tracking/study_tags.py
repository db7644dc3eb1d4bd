"""Tags of runs that have a meaning for this program or for MLflow."""

from simulation.foreign_text import without_pictures

NOTE, PARENT = "mlflow.note.content", "mlflow.parentRunId"
TRACKING = "studies.tracking"
"""Of a run in the project's store: the server that it is also sent to."""
RUN = "studies.run"
"""Of a run on a server: its id in the project's store."""


def with_line(note: str, lead: str, line: str, usual: str) -> str:
    """Return a note with a line of ours at its head; what a person wrote below or above it is kept.

    Args:
        note: as it is.
        lead: words that our line begins with; the one of before is known by them.
        line: what follows them; "" where there is nothing to say.
        usual: what stands below the line in a note that is still empty.
    """
    kept = [part for part in (note or usual).split("\n\n") if part and not part.startswith(lead)]
    return without_pictures("\n\n".join([*([f"{lead}{line}"] if line else []), *kept]))

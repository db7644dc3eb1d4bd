"""Tags of runs that have a meaning for this program or for MLflow."""

NOTE, PARENT = "mlflow.note.content", "mlflow.parentRunId"
TRACKING = "studies.tracking"
"""Of a run in the project's store: the server that it is also sent to."""
RUN = "studies.run"
"""Of a run on a server: its id in the project's store."""

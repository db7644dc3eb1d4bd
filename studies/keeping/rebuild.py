"""MLflow's database is a view: where it was removed, the next command writes it again from the records."""

from studies.console import Console
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords


def rebuild_mlflow(paths: ProjectPaths, console: Console) -> None:
    """Write MLflow's database again if it is gone and there is something to tell; costs nothing otherwise.

    Args:
        paths: the project.
        console: tells what is done.
    """
    if paths.storage is not None or paths.tracking_database.is_file():
        return
    from studies.keeping.stage_views import stage_manifests
    from studies.keeping.stores import read_stores

    stores = read_stores(paths)
    labels = sorted(folder.name for folder in (paths.mlruns / "results").glob("*") if folder.is_dir())
    has_trials = any(study.records for study in stores.studies)
    if not has_trials and not any(stage_manifests(paths, label) for label in labels):
        return
    console.say(f"{paths.show(paths.tracking_database)} is gone: writing it again from the records")
    from studies.keeping.mlflow_repairs import write_everything

    try:
        console.say(write_everything(stores))
    except Exception as error:
        why = hide_passwords(str(error).splitlines()[0] if str(error) else type(error).__name__)
        console.warn(f"MLflow's database is not whole ({why}); studies doctor --repair completes it")

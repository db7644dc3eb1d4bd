"""Putting MLflow right: every repair returns what it did."""

from collections.abc import Sequence

from studies.keeping.check_champions import newest
from studies.keeping.mlflow_tables import rewrite_places
from studies.keeping.stage_views import write_stages
from studies.keeping.stores import KeptStudy, Stores
from studies.keeping.views import tracker_of, write_to_mlflow
from studies.report.wording import count
from studies.tracking.mlflow_registry import model_name


def follow_move(stores: Stores, moved: dict[str, str]) -> str:
    """Tell MLflow where moved folders lie now."""
    n_places = rewrite_places(stores.paths, moved)
    return f"MLflow: {count(n_places, 'place')} rewritten"


def end_runs(stores: Stores, run_ids: Sequence[str]) -> str:
    """End runs that nobody works on."""
    client = tracker_of(stores.paths).client
    for run_id in run_ids:
        client.set_tag(run_id, "interrupted", "yes")
        client.set_terminated(run_id, "KILLED")
    return f"MLflow: {count(len(run_ids), 'run')} ended"


def write_study(stores: Stores, study: KeptStudy, bad: Sequence[str]) -> str:
    """Delete wrong runs of a study, and write what is missing."""
    client = tracker_of(stores.paths).client
    for run_id in dict.fromkeys(bad):
        client.delete_run(run_id)
    write_to_mlflow(study)
    removed = f", {count(len(set(bad)), 'run')} removed" if bad else ""
    return f"{study.name}: written to MLflow{removed}"


def write_everything(stores: Stores) -> str:
    """Write all studies and stages."""
    lines: list[str] = []
    for study in sorted(stores.studies, key=lambda one: one.entry.created_s):
        if study.records:
            write_to_mlflow(study)
    for label in sorted(folder.name for folder in (stores.paths.mlruns / "results").glob("*")):
        lines += write_stages(stores.paths, label)
    studies = count(len(stores.studies), "study", "studies")
    return "; ".join([f"MLflow: {studies} written from the records", *lines])


def write_missing_stages(stores: Stores, label: str) -> str:
    """Write the stages of a label that MLflow does not know."""
    return "; ".join([f"MLflow: the stages of {label} written", *write_stages(stores.paths, label)])


def write_files_again(stores: Stores, label: str, run_ids: Sequence[str]) -> str:
    """Write the files of runs again."""
    client = tracker_of(stores.paths).client
    again: list[str] = []
    for run_id in run_ids:
        tags = client.get_run(run_id).data.tags
        again.append(tags.get("study_key", ""))
        for name in ("told", "whole", "drawn"):
            if name in tags:
                client.delete_tag(run_id, name)
    for name in dict.fromkeys(again):
        if name in stores.by_name:
            write_to_mlflow(stores.by_name[name])
    lines = write_stages(stores.paths, label)
    return "; ".join([f"MLflow: the files of {count(len(run_ids), 'run')} of {label} written", *lines])


def take_alias_away(stores: Stores, model: str, alias: str) -> str:
    """Take an alias away that points at nothing, and register the champion."""
    tracker_of(stores.paths).client.delete_registered_model_alias(model, alias)
    return f"{model}: the alias {alias} is taken away" + _registered_again(stores, model)


def register_again(stores: Stores, model: str, version: int) -> str:
    """Remove a version without files, and register the champion."""
    tracker_of(stores.paths).client.delete_model_version(model, str(version))
    return f"{model}: version {version} removed" + _registered_again(stores, model)


def _registered_again(stores: Stores, model: str) -> str:
    for study in newest(stores):
        if model_name(study.entry.label, study.entry.n_train) == model:
            write_to_mlflow(study)
            return ", the champion registered again"
    return ""

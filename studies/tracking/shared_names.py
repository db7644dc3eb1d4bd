"""Names on a server or a database that several projects share: the first project of a name has it."""

from studies.tracking.quiet_mlflow import mlflow

PROJECT = "studies.project"
"""Tag of runs, experiments and models: the identity of their project."""


def own_experiment(client: mlflow.MlflowClient, name: str, identity: str, location: str | None = None) -> str:
    """Return the id of the project's experiment of a name, a new one where there is none.

    One without an owner was made by hand or by an earlier version, and serves all. One that was deleted is
    restored.

    Args:
        client: of the store.
        name: of the experiment; where another project has it, a part of the identity follows.
        identity: of the project; empty where it shares nothing.
        location: of the artifacts; None for the server's own.
    """
    for one in (name, f"{name} {identity[:6]}"):
        if (known := client.get_experiment_by_name(one)) is None:
            tags = {PROJECT: identity} if identity else {}
            try:
                return str(client.create_experiment(one, location, tags))
            except mlflow.MlflowException as error:
                # Another program was faster.
                if error.error_code != "RESOURCE_ALREADY_EXISTS":
                    raise
                known = client.get_experiment_by_name(one)
        if known is not None and known.tags.get(PROJECT, identity) == identity:
            if known.lifecycle_stage == "deleted":
                client.restore_experiment(known.experiment_id)
            break
    assert known is not None, "another program has made it"
    return str(known.experiment_id)


def own_model(client: mlflow.MlflowClient, name: str, identity: str) -> str:
    """Return the name of the project's registered model, which is made where there is none.

    Args:
        client: of the store.
        name: of the model; where another project has it, a part of the identity follows.
        identity: of the project; empty where it shares nothing.
    """
    for one in (name, f"{name}-{identity[:6]}"):
        found = [model for model in client.search_registered_models(f"name = '{one}'") if model.name == one]
        if not found:
            client.create_registered_model(one, {PROJECT: identity} if identity else {})
        if not found or found[0].tags.get(PROJECT, identity) == identity:
            break
    return one

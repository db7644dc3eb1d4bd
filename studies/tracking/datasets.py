"""The data sets of a study as MLflow shows them: digest, columns and where they lie."""

import json

from studies.paths import ProjectPaths
from studies.tracking.quiet_mlflow import Dataset, DatasetInput, InputTag
from studies.tuning.declaration import Declaration

_CONTEXTS = {"train": "training", "validation": "validation", "test": "testing"}


def dataset_inputs(spec: Declaration, paths: ProjectPaths) -> list[DatasetInput]:
    """Return a study's data sets."""
    columns = [
        {"type": "double", "name": name, "required": True}
        for name in (*spec.parameter_names, *spec.output_names)
    ]
    return [
        DatasetInput(
            Dataset(
                f"{spec.case_name} {name}" + (f" n={spec.n_train}" if name == "train" else ""),
                spec.digests[name][:32],
                "local",
                json.dumps({"set": spec.files[name]}),
                schema=json.dumps({"mlflow_colspec": columns}),
            ),
            [InputTag("mlflow.data.context", context)],
        )
        for name, context in _CONTEXTS.items()
    ]

"""A script: tunes as `studies tune` does. `python tune_script.py PROJECT N_TRIALS DECLARATION.json ...`."""

import json
import os
import sys
from pathlib import Path

from studies.paths import ProjectPaths
from studies.tuning.declaration import Declaration
from studies.tuning.tune_studies import tune


def main() -> None:
    specs = [Declaration(**json.loads(Path(file).read_text())) for file in sys.argv[3:]]
    storage = os.environ.get("STUDIES_STORAGE")
    paths = ProjectPaths(Path(sys.argv[1]), storage)
    tune(specs, paths=paths, n_trials=int(sys.argv[2]), n_jobs=2, n_parallel=2 if storage else 1)


if __name__ == "__main__":
    main()

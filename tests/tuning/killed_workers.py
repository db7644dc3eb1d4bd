"""A script: kills a worker of each study at another of its writes to Optuna's database, some twice.

python killed_workers.py PROJECT STUDY:WRITE[,WRITE] ...
"""

import os
import signal
import sys
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, event

from studies.paths import ProjectPaths
from studies.tuning.worker import Worker


def work_until(paths: ProjectPaths, name: str, n_writes: int) -> None:
    """Run a worker that is killed right before one of its writes."""
    worker, count = Worker(paths, name), 0

    def write(connection: Any) -> None:
        nonlocal count
        count += str(connection.engine.url.database).endswith("optuna.db")
        if count > n_writes:
            os.kill(os.getpid(), signal.SIGKILL)

    event.listen(Engine, "commit", write)
    worker.run()


def main() -> None:
    paths = ProjectPaths(Path(sys.argv[1]))
    for said in sys.argv[2:]:
        name, _, writes = said.rpartition(":")
        for n_writes in map(int, writes.split(",")):
            if not (child := os.fork()):
                work_until(paths, name, n_writes)
                os._exit(0)
            _, status = os.waitpid(child, 0)
            print(name, n_writes, "killed" if os.WIFSIGNALED(status) else f"ended {status}", flush=True)


if __name__ == "__main__":
    main()

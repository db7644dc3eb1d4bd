"""Process that sends runs to a server while a command works, and ends after it.

A server that does not answer holds up this process alone. `python -P -m studies.tracking.sender` reads the
project from its standard input, sends until that is closed, and then once more.
"""

import json
import math
import sys
import threading
import time
from contextlib import redirect_stdout
from pathlib import Path

from simulation.file_lock import FileLock
from studies.paths import ProjectPaths
from studies.server import Server
from studies.tracking.outbox import Outbox, ServerAwayError
from studies.words.quiet_loggers import working

INTERVAL_S = 3.0
"""Between two looks at what is new: a curve grows on the server's page as often."""
AWAY_S = 10.0
"""Before a server that did not answer is asked again."""
WAIT_S = 30.0
"""For the sender of another command to send what this command has written."""


def main() -> int:
    """Send until standard input is closed; what is to be said is written as a line each."""
    given = json.loads(sys.stdin.readline())
    there = given["server"]
    tags = tuple((name, value) for name, value in there["tags"])
    server = Server(there["uri"], there["registry"], there["experiment"], tags)
    paths = ProjectPaths(Path(given["root"]), given["storage"], server)
    is_over = threading.Event()

    def wait_for_end() -> None:
        sys.stdin.read()
        is_over.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    try:
        # MLflow prints the address of each run that ends.
        with working(), redirect_stdout(sys.stderr):
            _send_alone(paths, server, is_over)
    except Exception as error:
        # Nothing is lost: the project's own store has all, and whoever sends next begins from it.
        _say(f"runs are not sent to {server.uri}: {type(error).__name__}: {error}")
    return 0


def _send_alone(paths: ProjectPaths, server: Server, is_over: threading.Event) -> None:
    """Send, unless the sender of another command does: it sends for this command, too."""
    lock, give_up = FileLock(paths.mlruns / ".sent.lock"), math.inf
    while not lock.try_acquire():
        if is_over.wait(INTERVAL_S):
            give_up = min(give_up, time.monotonic() + WAIT_S)
            n_left = Outbox(paths, server, _say).n_missing(with_running=False)
            if not n_left:
                return
            if time.monotonic() > give_up:
                _say_missing(n_left, server, "another command sends them")
                return
            time.sleep(1.0)
    _send(Outbox(paths, server, _say), server, is_over)


def _send(outbox: Outbox, server: Server, is_over: threading.Event) -> None:
    while True:
        is_last, away, n_left = is_over.is_set(), "", 0
        try:
            n_left = outbox.send()
        except ServerAwayError as error:
            away = str(error)
        if is_last:
            n_left = outbox.n_missing() if away else n_left
            if n_left:
                why = f" ({away})" if away else ""
                _say_missing(n_left, server, f"kept here, and sent by the next command{why}")
            return
        is_over.wait(AWAY_S if away else INTERVAL_S)


def _say_missing(n_runs: int, server: Server, who: str) -> None:
    which = f"{n_runs} runs are" if n_runs > 1 else "1 run is"
    _say(f"{which} not on {server.uri} yet; {who}")


def _say(line: str) -> None:
    out = sys.__stdout__
    assert out is not None, "a pipe to the command"
    out.write(" ".join(line.split()) + "\n")
    out.flush()


if __name__ == "__main__":
    sys.exit(main())

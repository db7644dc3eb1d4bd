"""A Ctrl-C that some code drops is raised again; one that is handled is not."""

import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
# In processes of their own: the timer that looks again is pytest's as well.
BEGINNING = """
import signal, sys, time
from studies.interrupts import interrupt_handled, interrupts_kept

class Drops:
    def __del__(self):
        print("dropped")
        signal.raise_signal(signal.SIGINT)

def work(duration_s):
    end = time.monotonic() + duration_s
    while time.monotonic() < end:
        time.sleep(0.01)
"""


def said_by(script: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", BEGINNING + script],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stderr == ""
    return done.stdout.splitlines()


def test_one_that_is_dropped_is_raised_again() -> None:
    script = """
try:
    with interrupts_kept():
        Drops()
        work(30)
except KeyboardInterrupt:
    print("raised again")
"""
    assert said_by(script) == ["dropped", "raised again"]


def test_tidying_up_after_one_is_not_interrupted_again() -> None:
    script = """
from contextlib import contextmanager

@contextmanager
def opened():
    try:
        yield
    finally:
        work(0.6)
        print("closed")

try:
    with interrupts_kept(), opened():
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            work(0.6)
            print("tidied up")
except KeyboardInterrupt:
    print("handled")
"""
    assert said_by(script) == ["tidied up", "closed", "handled"]


def test_one_that_is_handled_is_over() -> None:
    script = """
with interrupts_kept():
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        interrupt_handled()
    work(0.6)
print("ended")
assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
"""
    assert said_by(script) == ["ended"]

"""Ctrl-C is heard, also where a library swallows it."""

import os
import signal
import threading
from contextlib import suppress

import pytest

from studies.ctrl_c import ctrl_c_heard, heed_ctrl_c


def press_ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def test_one_that_a_library_swallows_is_raised_at_the_next_step() -> None:
    with ctrl_c_heard():
        with suppress(BaseException):  # as a bare `except:` does
            press_ctrl_c()
        with pytest.raises(KeyboardInterrupt):
            heed_ctrl_c()


def test_an_earlier_one_is_forgotten_and_the_former_handler_comes_back() -> None:
    before = signal.getsignal(signal.SIGINT)
    with ctrl_c_heard(), suppress(KeyboardInterrupt):
        press_ctrl_c()
    with ctrl_c_heard():
        heed_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_can_work_without_it() -> None:
    seen: list[str] = []

    def work() -> None:
        with ctrl_c_heard():
            seen.append("worked")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == ["worked"]

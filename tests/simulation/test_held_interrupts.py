"""Ctrl-C waits while it is held, and comes through afterwards."""

import signal
import threading

import pytest

from simulation.workers.held_interrupts import interrupts_held


def test_an_interrupt_waits_until_it_is_let_through() -> None:
    with interrupts_held() as release:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            release()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_end_of_the_block_lets_it_through_too() -> None:
    with pytest.raises(KeyboardInterrupt), interrupts_held():
        signal.raise_signal(signal.SIGINT)
    with interrupts_held() as release:
        release()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_other_threads_have_nothing_to_hold() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen: list[object] = []

    def hold() -> None:
        with interrupts_held() as release:
            seen.append(signal.getsignal(signal.SIGINT))
            release()

    thread = threading.Thread(target=hold)
    thread.start()
    thread.join()
    assert seen == [before]

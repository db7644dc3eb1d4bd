"""Some seconds of the fuzzer; `python tests/fuzz --inputs 5000` for more."""

import time
import warnings

from hypothesis.errors import HypothesisWarning
from inputs_for_tests import KINDS, Outcomes, fuzz, project

LONGEST_S = 25.0
N_INPUTS = 200


def test_no_input_of_a_stranger_does_harm() -> None:
    outcomes = Outcomes()
    with project() as root, warnings.catch_warnings():
        warnings.simplefilter("ignore", HypothesisWarning)
        fuzz(root, outcomes, N_INPUTS, 0, time.monotonic() + LONGEST_S)
    assert not outcomes.violations, "\n".join(outcomes.violations[:5])
    assert {kind for kind, _ in outcomes.counts} >= {f"{kind}, right" for kind in KINDS} | set(KINDS)
    n_right = sum(n for (kind, _), n in outcomes.counts.items() if kind.endswith("right"))
    assert n_right >= sum(outcomes.counts.values()) / 5

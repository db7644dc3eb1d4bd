"""Some seconds of the fuzzer; `python tests/fuzz --inputs 5000` for more."""

import time
import warnings

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import HypothesisWarning
from inputs_for_tests import KINDS, Input, Outcomes, inputs, project, tried

LONGEST_S = 25.0
N_INPUTS = 200


def test_no_input_of_a_stranger_does_harm() -> None:
    outcomes, began = Outcomes(), time.monotonic()
    with project() as root, warnings.catch_warnings():
        warnings.simplefilter("ignore", HypothesisWarning)

        @settings(
            max_examples=N_INPUTS,
            derandomize=True,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(inputs())
        def fuzz(given_: Input) -> None:
            if time.monotonic() - began < LONGEST_S:
                tried(root, given_, outcomes)

        fuzz()
    assert not outcomes.violations, "\n".join(outcomes.violations[:5])
    assert {kind for kind, _ in outcomes.counts} >= {f"{kind}, right" for kind in KINDS} | set(KINDS)
    n_right = sum(n for (kind, _), n in outcomes.counts.items() if kind.endswith("right"))
    assert n_right >= sum(outcomes.counts.values()) / 5

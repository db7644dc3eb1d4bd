"""Fuzz for long: `python tests/fuzz --inputs 5000 --seed 1`; prints how inputs ended.

Exits 1 after a violation. FUZZ_KEEP=folder keeps the inputs that did harm.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parent)]

from hypothesis import HealthCheck, Phase, given, seed, settings  # noqa: E402
from inputs_for_tests import Input, Outcomes, inputs, project, tried  # noqa: E402


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    outcomes, began = Outcomes(), time.monotonic()
    warnings.simplefilter("ignore")
    with project() as root:

        @seed(chosen.seed)
        @settings(
            max_examples=chosen.inputs,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(inputs())
        def fuzz(given_: Input) -> None:
            tried(root, given_, outcomes)

        fuzz()
    for (kind, outcome), n in sorted(outcomes.counts.items()):
        print(f"{kind:18s} {outcome}: {n}")
    for violation in outcomes.violations:
        print(f"VIOLATION {violation}")
    n_right = sum(n for (kind, _), n in outcomes.counts.items() if kind.endswith("right"))
    print(
        f"{sum(outcomes.counts.values())} inputs, {n_right} of them right, {time.monotonic() - began:.0f} s; "
        f"slowest {outcomes.slowest_s:.1f} s; {len(outcomes.violations)} violations"
    )
    return bool(outcomes.violations)


if __name__ == "__main__":
    sys.exit(main())

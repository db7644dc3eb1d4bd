"""Fuzz for long: `python tests/fuzz --inputs 5000 --seed 1`; prints how inputs ended.

Exits 1 after a violation. FUZZ_KEEP=folder keeps the inputs that did harm.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parent)]

from inputs_for_tests import Outcomes, fuzz, project  # noqa: E402

ROUND = 500
"""Inputs of one seed; Hypothesis remembers all that it has drawn from one."""


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    outcomes, began, n, number = Outcomes(), time.monotonic(), 0, 0
    warnings.simplefilter("ignore")
    with project() as root:
        while n < chosen.inputs:
            fuzz(root, outcomes, min(ROUND, chosen.inputs - n), 1_000_003 * chosen.seed + number)
            n, number = sum(outcomes.counts.values()), number + 1
            n_right = sum(count for (kind, _), count in outcomes.counts.items() if kind.endswith("right"))
            print(
                f"{n} inputs, {n_right} of them right, {time.monotonic() - began:.0f} s; "
                f"slowest {outcomes.slowest_s:.1f} s; {len(outcomes.violations)} violations",
                flush=True,
            )
    for (kind, outcome), count in sorted(outcomes.counts.items()):
        print(f"{kind:18s} {outcome}: {count}")
    for violation in outcomes.violations:
        print(f"VIOLATION {violation}")
    return bool(outcomes.violations)


if __name__ == "__main__":
    sys.exit(main())

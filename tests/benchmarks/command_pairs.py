"""Type every two commands at once in one project: `python tests/benchmarks/command_pairs.py`.

Each pair begins at the same moment in a copy of a project. Each command has to go well, or to say in one line
why not. Then both are typed again, one by one. Numbers, rows, trials and runs must be those of the commands
alone, none lost and none doubled. Exits 1 otherwise. Takes some 40 minutes on two cores.
"""

import argparse
import sys
import tempfile
import time
from itertools import combinations_with_replacement
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[1])]

from pairs_for_tests import COMMANDS, Alone, make_base, wrong_of_pair  # noqa: E402


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", help="pairs with these commands alone")
    parser.add_argument("--exactly", action="append", metavar="A+B", help="these pairs alone")
    chosen = parser.parse_args()
    pairs = [
        pair
        for pair in combinations_with_replacement(COMMANDS, 2)
        if (not chosen.only or {*pair} & {*chosen.only})
        and (not chosen.exactly or "+".join(pair) in chosen.exactly)
    ]
    n_wrong = 0
    with tempfile.TemporaryDirectory(prefix="command-pairs-") as name:
        base, alone = Path(name) / "base", dict[str, Alone]()
        make_base(base)
        for pair in pairs:
            for one in {*pair} - {*alone}:
                with tempfile.TemporaryDirectory(dir=name) as folder:
                    alone[one] = Alone.of(base, one, Path(folder))
            began = time.monotonic()
            with tempfile.TemporaryDirectory(dir=name) as folder:
                wrong = wrong_of_pair(base, pair, alone, Path(folder))
            n_wrong += bool(wrong)
            verdict = f"WRONG {wrong}" if wrong else "good"
            print(f"{' + '.join(pair)}, {time.monotonic() - began:.0f} s: {verdict}", flush=True)
    print(f"{len(pairs)} pairs: {f'{n_wrong} BAD' if n_wrong else 'good'}")
    return bool(n_wrong)


if __name__ == "__main__":
    sys.exit(main())

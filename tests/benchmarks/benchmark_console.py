"""What benchmarks with methods of other packages say beside their tables."""

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Protocol


class NeedsPackages(Protocol):
    """A method that may lack packages."""

    @property
    def missing(self) -> list[str]:
        """What it lacks."""


def say(text: str) -> None:
    """Say how far it is, beside the tables."""
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


def with_packages(names: Sequence[str], methods: Mapping[str, NeedsPackages]) -> list[str]:
    """Return the methods that can run; say what the others want."""
    for name in names:
        if methods[name].missing:
            missing = ", ".join(methods[name].missing)
            say(f"without {name}: no {missing} (pip install -e '.[benchmark]', or what its module says)")
    return [name for name in names if not methods[name].missing]

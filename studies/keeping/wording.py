"""How sizes, ages and the contents of an archive are said."""

import re
from collections.abc import Sequence

from simulation.errors import InputError
from studies.report.wording import count

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")
_STAGES = {"calibrate": ("calibration", ""), "uncertainty": ("uncertainty", "uncertainties")}
_OTHER_STAGE = ("other stage", "")
_SECONDS = {"m": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}


def readable(size: float) -> str:
    """Return a number of bytes as people say it."""
    for unit in _UNITS:
        if size < 1000 or unit == _UNITS[-1]:
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1024
    raise AssertionError("unreachable")


def age(text: str) -> float:
    """Read an age such as 30d, 12h, 90m or 2w. [s].

    Raises:
        InputError: it is none.
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([mhdw])", text.strip())
    if found is None:
        raise InputError(f"--older-than {text!r} is no age; write for example 30d, 12h, 90m or 2w")
    return float(found[1]) * _SECONDS[found[2]]


def told_contents(
    *, n_studies: int, n_trials: int, n_champions: int, stages: Sequence[str], n_rows: int
) -> str:
    """Say what an archive brings: 1 study, 3 trials, 1 champion, 2 calibrations, 80 simulations.

    Args:
        n_studies: studies.
        n_trials: trials.
        n_champions: champions.
        stages: names of the stages whose results are in it.
        n_rows: simulations.
    """
    kinds = [_STAGES.get(name.rpartition("/")[2].partition("-")[0], _OTHER_STAGE) for name in stages]
    parts = [
        (n_studies, ("study", "studies")),
        (n_trials, ("trial", "")),
        (n_champions, ("champion", "")),
        *((kinds.count(kind), kind) for kind in (*_STAGES.values(), _OTHER_STAGE)),
        (n_rows, ("simulation", "")),
    ]
    return ", ".join(count(n, *noun) for n, noun in parts if n) or "nothing"

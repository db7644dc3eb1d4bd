"""Build FMUs that misbehave (bad.c) and say what each must answer; needs tests/fmus/bad on sys.path."""

from collections import Counter
from pathlib import Path

import numpy as np
from c_fmu_for_tests import write_fmu

SOURCE = Path(__file__).with_name("bad.c")
# Those that go wrong where `trouble` exceeds BAD_ABOVE; all others of bad.c always do.
SOMETIMES = ("CRASH", "HANG", "EXIT", "NANS", "ERROR", "DISCARD", "FATAL", "ONCE", "ASSERTS")
BAD_ABOVE = 0.995
BASE_K = 290.0
PARAMETERS = ("k", "x0", "trouble")
COUNT_VARIABLE = "BAD_FMU_COUNT"


def build_bad_fmu(behaviour: str, folder: Path) -> Path:
    """Compile one FMU, FMI 2.0 co-simulation; skips the test where there is no C compiler.

    ``behaviour`` is GOOD or another name of bad.c.
    """
    flags = ["-std=gnu99", "-Wall", "-Wextra", "-Werror", "-fno-builtin-memset", f"-DBEHAVIOUR={behaviour}"]
    once = ' canBeInstantiatedOnlyOncePerProcess="true"' if behaviour == "ONCE" else ""
    description = SOURCE.with_suffix(".xml").read_text().format(once=once)
    return write_fmu(folder / f"{behaviour}.fmu", description, SOURCE, *flags)


def make_theta(n: int, bad_rows: list[int], seed: int = 0) -> np.ndarray:
    """Parameters (k, x0, trouble), all different, of which exactly bad_rows are bad. Shape (n, 3)."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform([2e-5, 280.0, 0.0], [5e-4, 320.0, 0.99], size=(n, 3))
    theta[bad_rows, 2] = 0.999
    return theta


def closed_form(theta: np.ndarray, time: np.ndarray) -> np.ndarray:
    """What a good row answers: y at the time since the start. Shape (n, t). [K]"""
    return BASE_K + (theta[:, 1:2] - BASE_K) * np.exp(-theta[:, :1] * time)


def counted(path: Path) -> Counter[tuple[float, ...]]:
    """How often each row was simulated, by its parameters, from the file that BAD_FMU_COUNT names."""
    lines = path.read_text().splitlines() if path.exists() else []
    return Counter(tuple(float(value) for value in line.split(",")) for line in lines)

"""Build FMUs that misbehave (bad.c) and say what each must answer; needs tests/fmus/bad on sys.path."""

import shutil
import subprocess
import zipfile
from collections import Counter
from pathlib import Path

import fmpy
import numpy as np
import pytest

SOURCE = Path(__file__).with_name("bad.c")
# Those that go wrong where `trouble` exceeds BAD_ABOVE; all others of bad.c always do.
SOMETIMES = ("CRASH", "HANG", "EXIT", "NANS", "ERROR", "DISCARD", "FATAL", "ONCE", "ASSERTS")
BAD_ABOVE = 0.995
BASE_K = 290.0
PARAMETERS = ("k", "x0", "trouble")
COUNT_VARIABLE = "BAD_FMU_COUNT"

DESCRIPTION = SOURCE.with_name("bad.xml").read_text()


def build_bad_fmu(behaviour: str, folder: Path) -> Path:
    """Compile one FMU, FMI 2.0 co-simulation; skips the test where there is no C compiler.

    ``behaviour`` is GOOD or another name of bad.c.
    """
    compiler = shutil.which("gcc")
    if compiler is None or fmpy.platform != "linux64":
        pytest.skip("needs gcc on Linux to build the bad FMUs")
    library = folder / f"{behaviour}.so"
    headers = Path(fmpy.__file__).parent / "c-code"
    define = f"-DBEHAVIOUR={behaviour}"
    flags = ["-std=gnu99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-fno-builtin-memset"]
    subprocess.run([compiler, *flags, define, f"-I{headers}", "-o", library, SOURCE, "-lm"], check=True)
    once = ' canBeInstantiatedOnlyOncePerProcess="true"' if behaviour == "ONCE" else ""
    fmu = folder / f"{behaviour}.fmu"
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION.format(once=once))
        archive.write(library, "binaries/linux64/bad.so")
    library.unlink()
    return fmu


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

"""Build the FMU of kinds.c in FMI 2.0 or 3.0, and say what it must answer."""

import shutil
import subprocess
import tempfile
import zipfile
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest

from simulation import Parameter, ParameterSpace
from simulation.fmi.fmu import FmuSettings
from simulation.scenario import Scenario

SOURCE = Path(__file__).with_name("kinds.c")

DESCRIPTION_2 = SOURCE.with_name("kinds2.xml").read_text()

DESCRIPTION_3 = SOURCE.with_name("kinds3.xml").read_text()


def build_kinds_fmu(folder: Path, *, fmi: int, again: str = "HONEST", once: bool = False) -> Path:
    """Pack it; skips the test where there is no C compiler.

    ``again`` is one of the names in kinds.c; ``once`` is what the FMU says of itself.
    """
    description = DESCRIPTION_2 if fmi == 2 else DESCRIPTION_3
    platform = "linux64" if fmi == 2 else "x86_64-linux"
    path = folder / f"kinds{fmi}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description.format(once=str(once).lower()))
        archive.writestr(f"binaries/{platform}/kinds.so", _library(fmi, again))
    return path


@cache
def _library(fmi: int, again: str) -> bytes:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or fmpy.platform != "linux64":
        pytest.skip("needs a C compiler on Linux to build an FMU")
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", f"-DFMI={fmi}", f"-DAGAIN={again}"]
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "kinds.so"
        # gcc cannot know that a text cut at 63 characters still ends within its 64.
        command = [compiler, *flags, "-Wno-stringop-truncation", f"-I{headers}", "-o", library, SOURCE, "-lm"]
        subprocess.run(command, check=True)
        return library.read_bytes()


def kinds_settings(path: Path, *, names: tuple[str, ...] = ("k", "x0"), **more: object):
    """Half a day at 600 s with a swinging input, looked at every 1800 s."""
    bounds = {"k": (1e-5, 1e-3), "x0": (200.0, 400.0), "f": (0.5, 2.0)}
    space = ParameterSpace(tuple(Parameter(name, *bounds[name]) for name in names))
    edges = 600.0 * np.arange(73)
    scenario = Scenario(edges, 1e-3 * np.sin(edges[:-1, None] / 7e3), ("u",), 3)
    return FmuSettings(path, space, scenario, ("y",), np.zeros(1), **more)


def closed_form(settings: FmuSettings, k: float, x0: float) -> np.ndarray:
    """x at all output times, the warm-up's included. Shape (t,)."""
    scenario = settings.scenario
    x = [x0]
    for u, h in zip(scenario.inputs[:, 0], np.diff(scenario.time_communication), strict=True):
        x.append(x[-1] * np.exp(-k * h) + u * (1 - np.exp(-k * h)) / k)
    return np.array(x[:: scenario.output_every])

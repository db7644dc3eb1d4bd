"""Build the FMU of kinds.c in FMI 2.0 or 3.0, and say what it must answer."""

from pathlib import Path

import numpy as np
import pytest
from c_fmu_for_tests import WINDOWS, write_fmu

from simulation import Parameter, ParameterSpace
from simulation.fmi.fmu import FmuSettings
from simulation.scenario import Scenario

SOURCE = Path(__file__).with_name("kinds.c")
KINDS = [
    pytest.param({"fmi": fmi, "windows": windows}, id=f"FMI {fmi}.0{' for Windows' * windows}")
    for windows in (False, True)
    for fmi in (2, 3)
]
"""What build_kinds_fmu is given, for tests that hold for each of them."""


def build_kinds_fmu(
    folder: Path, *, fmi: int, again: str = "HONEST", once: bool = False, windows: bool = False
) -> Path:
    """Pack it; skips the test where there is no C compiler.

    ``again`` is one of the names in kinds.c; ``once`` is what the FMU says of itself; ``windows`` whether it
    has a binary for Windows alone.
    """
    description = SOURCE.with_name(f"kinds{fmi}.xml").read_text().format(once=str(once).lower())
    platform = WINDOWS[fmi - 2] if windows else "linux64" if fmi == 2 else "x86_64-linux"
    # gcc cannot know that a text cut at 63 characters still ends within its 64.
    flags = ["-Wall", "-Wextra", "-Werror", "-Wno-stringop-truncation", f"-DFMI={fmi}", f"-DAGAIN={again}"]
    return write_fmu(folder / f"kinds{fmi}.fmu", description, SOURCE, *flags, platform=platform)


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

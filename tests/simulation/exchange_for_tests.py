"""The FMUs made of exchange.c, one for each FMI version, and settings around them."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from c_fmu_for_tests import write_fmu

from simulation import FmuModel, Parameter, ParameterSpace
from simulation.fmi.fmu import FmuSettings
from simulation.scenario import Scenario

SOURCE = Path(__file__).with_name("exchange.c")
MODES = re.findall(r"^    ([A-Z_]+)", SOURCE.read_text().split("enum {\n")[1].split("};")[0], re.MULTILINE)


def build(folder: Path, version: str) -> Path:
    """Compile the models and pack them; skips without a C compiler."""
    flags, platform = (["-DFMI3"], "x86_64-linux") if version == "3.0" else ([], "linux64")
    description = SOURCE.with_name(f"exchange{version[0]}.xml").read_text()
    return write_fmu(folder / "exchange.fmu", description, SOURCE, *flags, platform=platform)


def settings(
    fmu: Path,
    mode: str,
    *,
    edges: Any,
    u: Any = 0.0,
    output_every: int = 1,
    rtol: float = 1e-6,
    **fixed: float,
) -> FmuSettings:
    """Drive a mode with parameters a and b calibrated and outputs y and n."""
    edges = np.asarray(edges, dtype=np.float64)
    inputs = np.broadcast_to(np.asarray(u, dtype=np.float64), (len(edges) - 1,))[:, None]
    space = ParameterSpace((Parameter("a", -1e9, 1e9), Parameter("b", -1e9, 1e9)))
    return FmuSettings(
        fmu,
        space,
        Scenario(edges, np.array(inputs), ("u",), output_every),
        ("y", "n"),
        np.zeros(2),
        fixed={"mode": float(MODES.index(mode)), **fixed},
        interface="model-exchange",
        relative_tolerance=rtol,
    )


def run(fmu: Path, mode: str, *, a: float = 0.0, b: float = 0.0, **choices: Any) -> Any:
    """Simulate one row of a mode."""
    with FmuModel(settings(fmu, mode, **choices)) as model:
        return model.simulate(np.array([[a, b]]))

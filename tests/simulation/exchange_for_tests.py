"""The FMUs made of exchange.c, one for each FMI version and number of states, and settings around them."""

import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from simulation import FmuModel, Parameter, ParameterSpace
from simulation.fmi.fmu import FmuSettings
from simulation.scenario import Scenario

SOURCE = Path(__file__).with_name("exchange.c")
MODES = re.findall(r"^    ([A-Z_]+)", SOURCE.read_text().split("enum {\n")[1].split("};")[0], re.MULTILINE)
NAMES = ("mode", "a", "b", "u", "x0", "x1", "der(x0)", "der(x1)", "y", "n", "nominal")
PARAMETERS = ("mode", "a", "b", "nominal")


def build(folder: Path, version: str, n_states: int, n_indicators: int = 1) -> Path:
    """Compile the models and pack them; skips without a C compiler."""
    compiler = shutil.which("gcc")
    if compiler is None or fmpy.platform != "linux64":
        pytest.skip("needs gcc on Linux to build the model-exchange FMUs")
    library = folder / "exchange.so"
    flags = ["-DFMI3"] if version == "3.0" else []
    headers = Path(fmpy.__file__).parent / "c-code"
    command = [compiler, "-O1", "-shared", "-fPIC", f"-I{headers}", *flags, "-o", library, SOURCE, "-lm"]
    subprocess.run(command, check=True)
    describe, platform = (_description_3, "x86_64-linux") if version == "3.0" else (_description_2, "linux64")
    path = folder / f"exchange{version[0]}_{n_states}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", describe(n_states, n_indicators))
        archive.write(library, f"binaries/{platform}/exchange.so")
    return path


def _causality(name: str) -> tuple[str, str]:
    if name in PARAMETERS:
        return "parameter", "tunable"
    return {"u": "input", "y": "output", "n": "output"}.get(name, "local"), "continuous"


def _description_2(n_states: int, n_indicators: int) -> str:
    variables = ""
    for reference, name in enumerate(NAMES):
        causality, variability = _causality(name)
        start = ' start="0"' if causality in ("parameter", "input") else ""
        state = ' derivative="{}"'.format(5 if name == "der(x0)" else 6) if name.startswith("der") else ""
        variables += (
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}"><Real{start}{state}/></ScalarVariable>'
        )
    for reference, name, kind, start in ((11, "off", "Boolean", "false"), (12, "level", "Integer", "0")):
        variables += (
            f'<ScalarVariable name="{name}" valueReference="{reference}" causality="input" '
            f'variability="discrete"><{kind} start="{start}"/></ScalarVariable>'
        )
    slopes = "".join(f'<Unknown index="{7 + i}"/>' for i in range(n_states))
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="exchange" '
        f'guid="exchange" numberOfEventIndicators="{n_indicators}">'
        '<ModelExchange modelIdentifier="exchange" providesDirectionalDerivative="true"/>'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure><Outputs>"
        f'<Unknown index="9"/><Unknown index="10"/></Outputs><Derivatives>{slopes}</Derivatives>'
        '<InitialUnknowns><Unknown index="9"/><Unknown index="10"/></InitialUnknowns>'
        "</ModelStructure></fmiModelDescription>"
    )


def _description_3(n_states: int, n_indicators: int) -> str:
    variables = ""
    for reference, name in enumerate(NAMES):
        causality, variability = _causality(name)
        start = ' start="0"' if causality in ("parameter", "input") else ""
        state = ' derivative="{}"'.format(4 if name == "der(x0)" else 5) if name.startswith("der") else ""
        variables += (
            f'<Float64 name="{name}" valueReference="{reference}" causality="{causality}" '
            f'variability="{variability}"{start}{state}/>'
        )
    variables += '<Boolean name="off" valueReference="11" causality="input" start="false"/>'
    variables += '<Int32 name="level" valueReference="12" causality="input" start="0"/>'
    variables += "".join(f'<Float64 name="z{i}" valueReference="{20 + i}"/>' for i in range(n_indicators))
    slopes = "".join(f'<ContinuousStateDerivative valueReference="{6 + i}"/>' for i in range(n_states))
    roots = "".join(f'<EventIndicator valueReference="{20 + i}"/>' for i in range(n_indicators))
    return (
        '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="exchange" '
        'instantiationToken="exchange">'
        '<ModelExchange modelIdentifier="exchange" providesDirectionalDerivatives="true"/>'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure>"
        f'<Output valueReference="8"/><Output valueReference="9"/>{slopes}{roots}'
        "</ModelStructure></fmiModelDescription>"
    )


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

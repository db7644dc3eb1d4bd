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
FLAGS = 'canGetAndSetFMUstate="{state}" canBeInstantiatedOnlyOncePerProcess="{once}"'
UNITS = '<UnitDefinitions><Unit name="1/s"><BaseUnit s="-1"/></Unit></UnitDefinitions>'

DESCRIPTION_2 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Kinds" guid="kinds-1" numberOfEventIndicators="0">
<CoSimulation modelIdentifier="kinds" {FLAGS}/>
{UNITS}
<TypeDefinitions><SimpleType name="Choice"><Enumeration><Item name="low" value="1"/>
<Item name="high" value="7"/></Enumeration></SimpleType></TypeDefinitions>
<DefaultExperiment tolerance="1e-7"/>
<ModelVariables>
<ScalarVariable name="k" valueReference="0" causality="parameter" variability="tunable">
<Real start="1e-4" unit="1/s"/>
</ScalarVariable>
<ScalarVariable name="x0" valueReference="1" causality="local" variability="continuous" initial="exact">
<Real start="300"/></ScalarVariable>
<ScalarVariable name="u" valueReference="2" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="3" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="f" valueReference="4" causality="parameter" variability="fixed"><Real start="1"/>
</ScalarVariable>
<ScalarVariable name="n" valueReference="5" causality="parameter" variability="fixed"><Integer start="0"/>
</ScalarVariable>
<ScalarVariable name="b" valueReference="6" causality="parameter" variability="fixed"><Boolean start="false"/>
</ScalarVariable>
<ScalarVariable name="c" valueReference="7" causality="parameter" variability="fixed">
<Enumeration declaredType="Choice" start="1"/></ScalarVariable>
<ScalarVariable name="s" valueReference="8" causality="parameter" variability="fixed"><String start=""/>
</ScalarVariable>
<ScalarVariable name="on" valueReference="11" causality="input" variability="discrete">
<Boolean start="false"/></ScalarVariable>
<ScalarVariable name="level" valueReference="12" causality="input" variability="discrete"><Integer start="0"/>
</ScalarVariable>
<ScalarVariable name="word" valueReference="13" causality="input" variability="discrete"><String start=""/>
</ScalarVariable>
<ScalarVariable name="inner" valueReference="14" causality="local"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="4"/></Outputs></ModelStructure>
</fmiModelDescription>
"""

DESCRIPTION_3 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Kinds" instantiationToken="kinds-1">
<CoSimulation modelIdentifier="kinds" {FLAGS.replace("FMUstate", "FMUState")}/>
{UNITS}
<TypeDefinitions><EnumerationType name="Choice"><Item name="low" value="1"/><Item name="high" value="7"/>
</EnumerationType></TypeDefinitions>
<DefaultExperiment tolerance="1e-7"/>
<ModelVariables>
<Float64 name="k" valueReference="0" causality="parameter" variability="tunable" start="1e-4"
unit="1/s"/>
<Float64 name="x0" valueReference="1" causality="local" initial="exact" start="300"/>
<Float64 name="u" valueReference="2" causality="input" start="0"/>
<Float64 name="y" valueReference="3" causality="output"><Alias name="also y"/></Float64>
<Float32 name="f" valueReference="4" causality="parameter" variability="tunable" start="1"/>
<Int8 name="n" valueReference="5" causality="parameter" start="0"/>
<Boolean name="b" valueReference="6" causality="parameter" start="false"/>
<Enumeration name="c" valueReference="7" causality="parameter" declaredType="Choice" start="1"/>
<String name="s" valueReference="8" causality="parameter"><Start value=""/></String>
<UInt64 name="size" valueReference="9" causality="structuralParameter" variability="fixed" start="2"/>
<Float64 name="many" valueReference="10" causality="parameter" start="0 0">
<Dimension valueReference="9"/></Float64>
<Boolean name="on" valueReference="11" causality="input" start="false"/>
<Int8 name="level" valueReference="12" causality="input" start="0"/>
<String name="word" valueReference="13" causality="input"><Start value=""/></String>
<Float64 name="inner" valueReference="14" causality="local"/>
<Float64 name="field" valueReference="15" causality="input" start="0 0">
<Dimension valueReference="9"/></Float64>
<Binary name="blob" valueReference="16" causality="input"><Start value="00"/></Binary>
<Clock name="tick" valueReference="17" causality="input" intervalVariability="triggered"/>
</ModelVariables>
<ModelStructure><Output valueReference="3"/><InitialUnknown valueReference="3"/></ModelStructure>
</fmiModelDescription>
"""


def build_kinds_fmu(
    folder: Path, *, fmi: int, again: str = "HONEST", state: bool = False, once: bool = False
) -> Path:
    """Pack it; skips the test where there is no C compiler.

    ``again`` is one of the names in kinds.c; ``state`` and ``once`` are what the FMU says of itself.
    """
    description = DESCRIPTION_2 if fmi == 2 else DESCRIPTION_3
    platform = "linux64" if fmi == 2 else "x86_64-linux"
    path = folder / f"kinds{fmi}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        said = {"state": str(state).lower(), "once": str(once).lower()}
        archive.writestr("modelDescription.xml", description.format(**said))
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


def kinds_settings(path: Path, *, names: tuple[str, ...] = ("k", "x0"), n_warmup: int = 0, **more: object):
    """Half a day at 600 s with a swinging input, looked at every 1800 s."""
    bounds = {"k": (1e-5, 1e-3), "x0": (200.0, 400.0), "f": (0.5, 2.0)}
    space = ParameterSpace(tuple(Parameter(name, *bounds[name]) for name in names))
    edges = 600.0 * np.arange(73)
    scenario = Scenario(edges, 1e-3 * np.sin(edges[:-1, None] / 7e3), ("u",), 3, n_warmup)
    return FmuSettings(path, space, scenario, ("y",), np.zeros(1), **more)


def closed_form(settings: FmuSettings, k: float, x0: float) -> np.ndarray:
    """x at all output times, the warm-up's included. Shape (t,)."""
    scenario = settings.scenario
    x = [x0]
    for u, h in zip(scenario.inputs[:, 0], np.diff(scenario.time_communication), strict=True):
        x.append(x[-1] * np.exp(-k * h) + u * (1 - np.exp(-k * h)) / k)
    return np.array(x[:: scenario.output_every])

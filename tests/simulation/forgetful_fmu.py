"""FMUs whose reset leaves something behind, each in its own way (forgetful.c)."""

import re
from pathlib import Path

import numpy as np
from c_fmu_for_tests import write_fmu

from simulation import Parameter, ParameterSpace
from simulation.fmi.fmu import FmuSettings
from simulation.scenario import Scenario
from simulation.store.store import SimulationStore

SOURCE = Path(__file__).with_name("forgetful.c")
FAULTS = tuple(re.findall(r"^#define ([A-Z_]+) \d+", SOURCE.read_text(), flags=re.MULTILINE)[1:])
"""Their names in forgetful.c, NONE left out."""

_VARIABLE = (
    '<ScalarVariable name="{0}" valueReference="{1}" causality="{2}" variability="{3}"{5}><Real{4}/>'
    "</ScalarVariable>"
)
_START = ' start="300"'
_VARIABLES = (
    ("k", 0, "parameter", "fixed", ' start="1e-4"', ""),
    ("x0", 1, "parameter", "fixed", _START, ""),
    ("u", 2, "input", "continuous", _START, ""),
    ("y", 3, "output", "continuous", "", ' initial="calculated"'),
    ("z", 4, "output", "continuous", "", ' initial="calculated"'),
)
_DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="forgetful" guid="forgetful">
<CoSimulation modelIdentifier="forgetful" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>{"".join(_VARIABLE.format(*one) for one in _VARIABLES)}</ModelVariables>
<ModelStructure><Outputs><Unknown index="4"/><Unknown index="5"/></Outputs></ModelStructure>
</fmiModelDescription>"""


def forgetful_settings(folder: Path, fault: str = "NONE") -> FmuSettings:
    """Half a day at 600 s; skips the test where there is no C compiler."""
    path = write_fmu(folder / f"{fault.lower()}.fmu", _DESCRIPTION, SOURCE, f"-DFAULT={fault}", "-w")
    space = ParameterSpace((Parameter("k", 1e-5, 3e-4), Parameter("x0", 270.0, 320.0)))
    edges = 600.0 * np.arange(73)
    scenario = Scenario(edges, 280.0 + 8.0 * np.sin(edges[:-1, None] / 7e3), ("u",), 1)
    return FmuSettings(path, space, scenario, ("y", "z"), np.zeros(2))


def store_of(settings: FmuSettings, file: Path) -> SimulationStore:
    """Open a store of such an FMU."""
    return SimulationStore(
        file,
        model_digest="forgetful",
        parameter_names=settings.parameter_space.names,
        output_names=settings.output_names,
        time=settings.scenario.time,
    )

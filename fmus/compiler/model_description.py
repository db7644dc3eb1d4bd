"""Write modelDescription.xml, in FMI 2.0 and 3.0: what the templates beside this module say of a model."""

import re
from collections import Counter
from dataclasses import replace
from importlib.metadata import version
from itertools import count
from typing import Any

import casadi as ca

from fmus.compiler.causal import Ode, column
from fmus.compiler.filled import filled
from fmus.compiler.modelica import Variable
from fmus.compiler.settings import BuildSettings, CompileError

KELVIN = 273.15
Attributes = tuple[dict[str, Any], dict[str, Any]]
"""Of a variable: those of every variable, and those of a real one."""


def write_description(ode: Ode, settings: BuildSettings, guid: str) -> str:
    """Write the modelDescription.xml of an FMU.

    Value references and variables are in this order: states, their derivatives, inputs, parameters, outputs,
    discrete variables; in FMI 3.0 then the time.

    Args:
        ode: Explicit model.
        settings: Names, version of FMI and default experiment.
        guid: GUID of the FMU.

    Returns:
        Text of modelDescription.xml.

    Raises:
        CompileError: If a variable has no unit, or an unknown one.
    """
    is_fmi3 = settings.fmi_version == "3.0"
    if is_fmi3 and ode.has_events:
        raise CompileError(f'{ode.name}: events are written in fmi_version = "2.0" alone')
    about = {
        "fmiVersion": settings.fmi_version,
        "modelName": ode.name,
        "instantiationToken" if is_fmi3 else "guid": guid,
        "description": ode.description,
        "generationTool": f"fmus.compiler (pymoca {version('pymoca')}, CasADi {version('casadi')})",
        "variableNamingConvention": "structured",
        **({} if is_fmi3 else {"numberOfEventIndicators": len(ode.truths)}),
    }
    variables = _variables(ode)
    time = len(variables) + len(ode.truths)
    dependencies = _dependencies(ode, time)
    if is_fmi3:
        # FMI 2.0 refers to a state by its place in the list, FMI 3.0 by its value reference.
        for _, real in variables:
            real |= {"derivative": real["derivative"] - 1} if "derivative" in real else {}
    else:
        dependencies = {
            tag: [(index, [known + 1 for known in knowns if known != time]) for index, knowns in unknowns]
            for tag, unknowns in dependencies.items()
        }
    units = sorted({*(real["unit"] for _, real in variables), *["s"] * is_fmi3})
    return filled(
        "modelDescription.xml.jinja",
        about=about,
        settings=settings,
        units={unit: base_powers(unit) | ({"offset": KELVIN} if unit == "degC" else {}) for unit in units},
        variables=variables,
        dependencies=dependencies,
        time=time,
    )


def _variables(ode: Ode) -> list[Attributes]:
    derivatives = [
        replace(
            state,
            name=f"der({state.name})",
            unit=f"{state.unit}/s",
            description=f"Time derivative of {state.name}",
            minimum=None,
            maximum=None,
        )
        for state in ode.states
    ]
    calculated = {"variability": "continuous", "initial": "calculated"}
    rows = [
        _scalar(variable, causality=causality, **attributes)
        for variables, causality, attributes in (
            (ode.states, "local", calculated),
            (derivatives, "local", calculated),
            (ode.inputs, "input", {"variability": "continuous"}),
            (ode.parameters, "parameter", {"variability": "fixed", "initial": "exact"}),
            (ode.outputs, "output", calculated),
            (ode.discrete, "local", {**calculated, "variability": "discrete"}),
        )
        for variable in variables
    ]
    for index, (_, real) in enumerate(rows[len(ode.states) : 2 * len(ode.states)], start=1):
        real["derivative"] = index
    if len({scalar["name"] for scalar, _ in rows}) != len(rows):
        raise CompileError(f"{ode.name}: an output is a state; give it its own name and an equation")
    return rows


def _scalar(variable: Variable, **attributes: str) -> Attributes:
    if not variable.unit:
        raise CompileError(f'{variable.name}: has no unit; give it one in the source (unit="1" for a number)')
    ends = {"min": variable.minimum, "max": variable.maximum}
    real = {"unit": variable.unit} | {name: end for name, end in ends.items() if end is not None}
    if attributes["causality"] in {"input", "parameter"}:
        real["start"] = float(variable.start)
    description = {"description": variable.description} if variable.description else {}
    return {"name": variable.name, **description, **attributes}, real


def _dependencies(ode: Ode, time_reference: int) -> dict[str, list[tuple[int, list[int]]]]:
    """Return what each unknown depends on, both by value reference.

    Derivatives and outputs depend on states and inputs, initial values on inputs and parameters, all on time.
    """
    references, time = count(), (time_reference, ode.time)
    # Value references count through these, in the order of `_variables`.
    states, derivatives, inputs, parameters, outputs = (
        [(next(references), symbols[i]) for i in range(symbols.numel())]
        for symbols in (ode.x, ode.derivative, column([v.symbol for v in ode.inputs]), ode.p, ode.output)
    )
    # At the start the states are themselves unknowns; what they depend on takes their place.
    initial = [(i, ode.start[i]) for i, _ in states]
    truths, started = column(list(ode.truths)), column([v.symbol for v in (*ode.states, *ode.discrete)])
    for index, expression in (*derivatives, *outputs):
        # A condition depends on whatever its margin does.
        unfolded = ca.substitute(expression, truths, ode.margins) if ode.truths else expression
        initial.append((index, ca.substitute(unfolded, started, ode.start)))
    return {
        tag: [
            (index, [known for known, symbol in knowns if ca.depends_on(expression, symbol)])
            for index, expression in unknowns
        ]
        for tag, unknowns, knowns in (
            ("Outputs", outputs, [*states, *inputs, time]),
            ("Derivatives", derivatives, [*states, *inputs, time]),
            ("InitialUnknowns", initial, [*inputs, *parameters, time]),
        )
    }


_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DEFINED = {
    "N": "kg.m.s-2", "Pa": "kg.m-1.s-2", "J": "kg.m2.s-2", "W": "kg.m2.s-3", "V": "kg.m2.s-3.A-1",
    "degC": "K", "1": "",
}  # fmt: skip
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d+)?")


def base_powers(unit: str) -> dict[str, int]:
    """Resolve a unit such as ``W/(m2.K)`` into powers of base units, such as ``{"kg": 1, "s": -3, "K": -1}``.

    Args:
        unit: Modelica unit: factors joined by points, at most one slash, exponents as digits; a multiple of
            an SI unit is none.

    Raises:
        CompileError: If the unit is unknown or malformed.
    """
    over, _, under = unit.partition("/")
    powers = Counter[str]()
    for sign, part in ((1, over), (-1, under.strip("()"))):
        for text in filter(None, part.split(".")):
            match = _FACTOR.fullmatch(text)
            if match is None or match[1] not in (*_BASE, *_DEFINED):
                raise CompileError(
                    f"unit {unit!r}: {text!r} is not known; add it to fmus/compiler/model_description.py"
                )
            name, exponent = match[1], sign * int(match[2] or 1)
            own = {name: 1} if name in _BASE else base_powers(_DEFINED[name])
            for base, power in own.items():
                powers[base] += power * exponent
    return {name: power for name, power in powers.items() if power}

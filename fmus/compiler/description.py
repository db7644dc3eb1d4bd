"""Write modelDescription.xml."""

from collections.abc import Iterable
from importlib.metadata import version
from xml.etree import ElementTree

import casadi as ca

from fmus.compiler.causal import Ode
from fmus.compiler.errors import CompileError
from fmus.compiler.modelica import Variable
from fmus.compiler.settings import BuildSettings
from fmus.compiler.units import derivative_unit, parse_unit

# The C sources in the order of their compilation; the headers lie beside them.
SOURCE_FILES = ("fmi2.c", "integrate.c", "model.c")


def write_description(ode: Ode, settings: BuildSettings, guid: str) -> str:
    """Describe an FMU.

    Value references and variables are in this order: states, their derivatives, inputs, parameters, outputs.

    Args:
        ode: Explicit model.
        settings: Names and default experiment.
        guid: GUID of the FMU.

    Returns:
        Text of modelDescription.xml.

    Raises:
        CompileError: If a variable has no unit, or an unknown one.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=ode.name,
        guid=guid,
        description=ode.description,
        generationTool=f"fmus.compiler (pymoca {version('pymoca')}, CasADi {version('casadi')})",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    common = {
        "modelIdentifier": settings.identifier,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    exchange = ElementTree.SubElement(root, "ModelExchange", common, completedIntegratorStepNotNeeded="true")
    simulation = ElementTree.SubElement(
        root, "CoSimulation", common, canHandleVariableCommunicationStepSize="true"
    )
    for element in (exchange, simulation):
        files = ElementTree.SubElement(element, "SourceFiles")
        for name in SOURCE_FILES:
            ElementTree.SubElement(files, "File", name=name)
    variables = _variables(ode)
    _unit_definitions(root, [attributes["unit"] for _, attributes in variables])
    categories = ElementTree.SubElement(root, "LogCategories")
    ElementTree.SubElement(categories, "Category", name="logStatusError", description="Every error")
    ElementTree.SubElement(
        root,
        "DefaultExperiment",
        startTime=repr(settings.start_time_s),
        stopTime=repr(settings.stop_time_s),
        tolerance=repr(settings.tolerance),
        stepSize=repr(settings.step_size_s),
    )
    listed = ElementTree.SubElement(root, "ModelVariables")
    for reference, (scalar, real) in enumerate(variables):
        element = ElementTree.SubElement(listed, "ScalarVariable", scalar, valueReference=str(reference))
        ElementTree.SubElement(element, "Real", real)
    _structure(root, ode)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _variables(ode: Ode) -> list[tuple[dict[str, str], dict[str, str]]]:
    rows: list[tuple[dict[str, str], dict[str, str]]] = []
    for state in ode.states:
        rows.append(_scalar(state, causality="local", variability="continuous", initial="calculated"))
    for index, state in enumerate(ode.states):
        derivative = Variable(
            name=f"der({state.name})",
            symbol=None,
            unit=derivative_unit(state.unit),
            description=f"Time derivative of {state.name}",
            minimum=None,
            maximum=None,
            start=None,
        )
        scalar, real = _scalar(derivative, causality="local", variability="continuous", initial="calculated")
        rows.append((scalar, {**real, "derivative": str(index + 1)}))
    for variable in ode.inputs:
        rows.append(_scalar(variable, causality="input", variability="continuous"))
    for variable in ode.parameters:
        rows.append(_scalar(variable, causality="parameter", variability="fixed", initial="exact"))
    for variable in ode.outputs:
        rows.append(_scalar(variable, causality="output", variability="continuous", initial="calculated"))
    if not ode.states:
        raise CompileError(f"{ode.name}: has no state; there is nothing to simulate")
    if len({scalar["name"] for scalar, _ in rows}) != len(rows):
        raise CompileError(f"{ode.name}: an output is a state; give it its own name and an equation")
    return rows


def _scalar(variable: Variable, **attributes: str) -> tuple[dict[str, str], dict[str, str]]:
    if not variable.unit:
        raise CompileError(f'{variable.name}: has no unit; give it one in the source (unit="1" for a number)')
    real = {"unit": variable.unit}
    if variable.minimum is not None:
        real["min"] = repr(variable.minimum)
    if variable.maximum is not None:
        real["max"] = repr(variable.maximum)
    if attributes["causality"] in {"input", "parameter"}:
        real["start"] = repr(float(variable.start))
    description = {"description": variable.description} if variable.description else {}
    return {"name": variable.name, **description, **attributes}, real


def _unit_definitions(root: ElementTree.Element, units: Iterable[str]) -> None:
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted(set(units)):
        base = parse_unit(unit)
        attributes = {name: str(power) for name, power in base.powers.items()}
        if base.factor != 1.0:
            attributes["factor"] = repr(base.factor)
        if base.offset != 0.0:
            attributes["offset"] = repr(base.offset)
        ElementTree.SubElement(ElementTree.SubElement(definitions, "Unit", name=unit), "BaseUnit", attributes)


def _structure(root: ElementTree.Element, ode: Ode) -> None:
    """Dependencies: of derivatives and outputs on states and inputs, of initial values also on parameters."""
    n_states, n_inputs, n_parameters = len(ode.states), len(ode.inputs), len(ode.parameters)
    states = [(i + 1, v.symbol) for i, v in enumerate(ode.states)]
    inputs = [(2 * n_states + i + 1, v.symbol) for i, v in enumerate(ode.inputs)]
    parameters = [(2 * n_states + n_inputs + i + 1, v.symbol) for i, v in enumerate(ode.parameters)]
    first_output = 2 * n_states + n_inputs + n_parameters + 1
    outputs = [(first_output + i, ode.output[i]) for i in range(len(ode.outputs))]
    derivatives = [(n_states + i + 1, ode.derivative[i]) for i in range(n_states)]
    # At the start the states are themselves unknowns; what they depend on takes their place.
    initial = [(i + 1, ode.start[i]) for i in range(n_states)]
    for index, expression in (*derivatives, *outputs):
        initial.append((index, ca.substitute(expression, ode.x, ode.start)))
    structure = ElementTree.SubElement(root, "ModelStructure")
    for tag, unknowns, knowns in (
        ("Outputs", outputs, [*states, *inputs]),
        ("Derivatives", derivatives, [*states, *inputs]),
        ("InitialUnknowns", initial, [*inputs, *parameters]),
    ):
        parent = ElementTree.SubElement(structure, tag)
        for index, expression in unknowns:
            depends_on = " ".join(str(known) for known, symbol in knowns if ca.depends_on(expression, symbol))
            ElementTree.SubElement(parent, "Unknown", index=str(index), dependencies=depends_on)

"""Write modelDescription.xml, in FMI 2.0 and 3.0."""

from collections.abc import Iterable
from dataclasses import replace
from importlib.metadata import version
from xml.etree import ElementTree

import casadi as ca

from fmus.compiler.base_units import base_powers
from fmus.compiler.causal import Ode, column
from fmus.compiler.compile_error import CompileError
from fmus.compiler.modelica import Variable
from fmus.compiler.settings import BuildSettings

KELVIN = 273.15
Attributes = tuple[dict[str, str], dict[str, str]]
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
    root = ElementTree.Element(
        "fmiModelDescription",
        {
            "fmiVersion": settings.fmi_version,
            "modelName": ode.name,
            "instantiationToken" if is_fmi3 else "guid": guid,
            "description": ode.description,
            "generationTool": f"fmus.compiler (pymoca {version('pymoca')}, CasADi {version('casadi')})",
            "variableNamingConvention": "structured",
        },
    )
    if not is_fmi3:
        root.set("numberOfEventIndicators", str(len(ode.truths)))
    variables = _variables(ode)
    _interfaces(root, settings)
    _unit_definitions(root, {*(attributes["unit"] for _, attributes in variables), *["s"] * is_fmi3})
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
    structure = ElementTree.Element("ModelStructure")
    (_list_fmi3 if is_fmi3 else _list_fmi2)(ode, variables, listed, structure)
    root.append(structure)
    return _text(root)


def write_build_description(settings: BuildSettings) -> str:
    """Write how the sources of an FMI 3.0 FMU are compiled.

    Args:
        settings: Names.

    Returns:
        Text of buildDescription.xml.
    """
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(
        root, "BuildConfiguration", modelIdentifier=settings.identifier, description="Any C99 compiler"
    )
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    for name in settings.source_files:
        ElementTree.SubElement(files, "SourceFile", name=name)
    return _text(root)


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _interfaces(root: ElementTree.Element, settings: BuildSettings) -> None:
    is_fmi3 = settings.fmi_version == "3.0"
    step = {"canHandleVariableCommunicationStepSize": "true"}
    kinds = {"ModelExchange": {} if is_fmi3 else {"completedIntegratorStepNotNeeded": "true"}}
    kinds |= {} if settings.model_exchange_only else {"CoSimulation": step}
    common = {"modelIdentifier": settings.identifier}
    abilities = ["canGetAndSetFMUState", "canSerializeFMUState", "providesDirectionalDerivatives"]
    if not is_fmi3:
        abilities = [
            "canNotUseMemoryManagementFunctions", "canGetAndSetFMUstate", "canSerializeFMUstate",
            "providesDirectionalDerivative",
        ]  # fmt: skip
    for kind, more in kinds.items():
        element = ElementTree.SubElement(root, kind, {**common, **dict.fromkeys(abilities, "true"), **more})
        if not is_fmi3:
            files = ElementTree.SubElement(element, "SourceFiles")
            for name in settings.source_files:
                ElementTree.SubElement(files, "File", name=name)


def _list_fmi2(
    ode: Ode, variables: list[Attributes], listed: ElementTree.Element, structure: ElementTree.Element
) -> None:
    for reference, (scalar, real) in enumerate(variables):
        element = ElementTree.SubElement(listed, "ScalarVariable", scalar, valueReference=str(reference))
        ElementTree.SubElement(element, "Real", real)
    for tag, unknowns in _dependencies(ode).items():
        parent = ElementTree.SubElement(structure, tag)
        for reference, depends_on in unknowns:
            dependencies = " ".join(str(known + 1) for known in depends_on if known != _time_reference(ode))
            ElementTree.SubElement(parent, "Unknown", index=str(reference + 1), dependencies=dependencies)


def _list_fmi3(
    ode: Ode, variables: list[Attributes], listed: ElementTree.Element, structure: ElementTree.Element
) -> None:
    if ode.has_events:
        raise CompileError(f'{ode.name}: events are written in fmi_version = "2.0" alone')
    for reference, (scalar, real) in enumerate(variables):
        # FMI 2.0 refers to a state by its place in the list, FMI 3.0 by its value reference.
        if "derivative" in real:
            real = {**real, "derivative": str(int(real["derivative"]) - 1)}
        ElementTree.SubElement(listed, "Float64", {**scalar, "valueReference": str(reference), **real})
    about = {"name": "time", "valueReference": str(_time_reference(ode)), "description": "Time"}
    ElementTree.SubElement(listed, "Float64", about, causality="independent", unit="s")
    tags = {
        "Outputs": "Output",
        "Derivatives": "ContinuousStateDerivative",
        "InitialUnknowns": "InitialUnknown",
    }
    for tag, unknowns in _dependencies(ode).items():
        for reference, depends_on in unknowns:
            about = {"valueReference": str(reference), "dependencies": " ".join(map(str, depends_on))}
            ElementTree.SubElement(structure, tags[tag], about)


def _time_reference(ode: Ode) -> int:
    n_rest = len(ode.inputs) + len(ode.parameters) + len(ode.outputs) + len(ode.discrete)
    return 2 * len(ode.states) + n_rest + len(ode.truths)


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
        real["derivative"] = str(index)
    if len({scalar["name"] for scalar, _ in rows}) != len(rows):
        raise CompileError(f"{ode.name}: an output is a state; give it its own name and an equation")
    return rows


def _scalar(variable: Variable, **attributes: str) -> Attributes:
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
    for unit in sorted(units):
        attributes = {name: str(power) for name, power in base_powers(unit).items()}
        if unit == "degC":
            attributes["offset"] = repr(KELVIN)
        ElementTree.SubElement(ElementTree.SubElement(definitions, "Unit", name=unit), "BaseUnit", attributes)


def _dependencies(ode: Ode) -> dict[str, list[tuple[int, list[int]]]]:
    """Return what each unknown depends on, both by value reference.

    Derivatives and outputs depend on states and inputs, initial values on inputs and parameters, all on time.
    """
    n_states, n_inputs, n_parameters = len(ode.states), len(ode.inputs), len(ode.parameters)
    states = [(i, v.symbol) for i, v in enumerate(ode.states)]
    inputs = [(2 * n_states + i, v.symbol) for i, v in enumerate(ode.inputs)]
    parameters = [(2 * n_states + n_inputs + i, v.symbol) for i, v in enumerate(ode.parameters)]
    time = (_time_reference(ode), ode.time)
    first_output = 2 * n_states + n_inputs + n_parameters
    outputs = [(first_output + i, ode.output[i]) for i in range(len(ode.outputs))]
    derivatives = [(n_states + i, ode.derivative[i]) for i in range(n_states)]
    # At the start the states are themselves unknowns; what they depend on takes their place.
    initial = [(i, ode.start[i]) for i in range(n_states)]
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

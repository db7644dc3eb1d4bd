"""Read a Modelica model as flat equations in CasADi symbols, by pymoca."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
from pymoca import ast, parser
from pymoca.backends.casadi import generator
from pymoca.tree import flatten

from fmus.compiler.events import EventNames, take_out_events
from fmus.compiler.settings import CompileError

# CasADi 3.8 dropped the Python 2 name of the division that pymoca 0.12 asks for.
generator.OP_MAP["/"] = "__truediv__"


@dataclass(frozen=True)
class Variable:
    """A scalar variable of the flat model.

    Attributes:
        name: Flat Modelica name.
        symbol: Its CasADi symbol (SX).
        unit: Unit in Modelica's notation; empty when the source gives none.
        description: Description string.
        minimum: Least value, or None.
        maximum: Greatest value, or None.
        start: Value of a parameter, start value of an input; start expression of a state (SX).
    """

    name: str
    symbol: Any
    unit: str
    description: str
    minimum: float | None
    maximum: float | None
    start: Any


@dataclass(frozen=True)
class Check:
    """A quantity of a component that must be finite and within its declared limits, such as a capacity."""

    name: str
    expression: Any
    unit: str
    minimum: float
    maximum: float


@dataclass(frozen=True)
class FlatModel:
    """Equations ``residual(time, states, derivatives, algebraics, inputs, parameters) = 0``, all SX.

    With events, the equations also hold the discrete variables and the truth values of relations, which
    change at events alone, and have more algebraic variables: those that `events` names.
    """

    name: str
    description: str
    time: Any
    states: tuple[Variable, ...]
    derivatives: tuple[Any, ...]
    algebraics: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    output_names: tuple[str, ...]
    residual: Any
    checks: tuple[Check, ...]
    discrete: tuple[Variable, ...]
    truths: tuple[Any, ...]
    events: EventNames


def read_model(sources: list[Path], class_name: str, *, with_events: bool = False) -> FlatModel:
    """Read, flatten and resolve a model.

    Constants, parameters of components and parameters that are bound to expressions are replaced by what they
    are bound to; the other parameters of the model itself remain.

    Args:
        sources: Modelica files.
        class_name: Qualified class to read.
        with_events: Whether relations make events. If not, each is looked at whenever the equations are.

    Returns:
        The flat model.

    Raises:
        CompileError: If the source does not parse, or leaves the subset that is understood.
    """
    try:
        parsed, *others = [parser.parse(path.read_text(encoding="utf-8")) for path in sources]
        for other in others:
            parsed.extend(other)
        tree = flatten(parsed, ast.ComponentRef.from_string(class_name))
        flat_class = tree.classes[class_name]
        # What pymoca's CasADi model leaves out: units and descriptions.
        symbols, description = dict(flat_class.symbols), flat_class.comment or ""
        events = EventNames()
        if with_events:
            events = take_out_events(flat_class)
        elif any(isinstance(equation, ast.WhenEquation) for equation in flat_class.equations):
            raise CompileError(f"{class_name}: has a when; write events = true into the build file")
        # What pymoca's `generate` does after flattening.
        options: Any = generator._merge_default_options(None)  # more than the type it declares
        writer = generator.Generator(tree, class_name, options)
        generator.GeneratorWalker().walk(writer, tree)
    except CompileError:
        raise
    except Exception as error:  # pymoca raises whatever its walk runs into
        said = " ".join(str(error).split())
        raise CompileError(
            f"{class_name}: pymoca cannot read it ({type(error).__name__}: {said}); keep to its subset"
        ) from error
    return _resolve(writer.model, class_name, symbols, description, events)


def _resolve(
    raw: Any, class_name: str, symbols: dict[str, Any], description: str, events: EventNames
) -> FlatModel:
    """Turn pymoca's model into scalar SX expressions of time, states, inputs and free parameters."""
    if raw.initial_equations or raw.delay_states:
        raise CompileError(f"{class_name}: initial equations and delays are not understood; use fixed states")
    everything = [*raw.states, *raw.der_states, *raw.alg_states, *raw.inputs, *raw.constants, *raw.parameters]
    for variable in everything:
        if variable.symbol.shape != (1, 1) or not _is_scalar(variable):
            raise CompileError(f"{class_name}: {variable.symbol.name()} is an array; write its elements out")
    known = [*raw.constants, *raw.parameters]
    mx = [raw.time, *(v.symbol for v in everything)]
    sx = [ca.SX.sym(symbol.name()) for symbol in mx]
    by_name = {symbol.name(): symbol for symbol in sx}

    def convert(expressions: list[Any]) -> list[Any]:
        function = ca.Function("convert", mx, [ca.densify(ca.MX(e)) for e in expressions])
        return list(function.call(sx))

    values = convert([v.value for v in known])
    values_of = {v.symbol.name(): x for v, x in zip(known, values, strict=True)}
    numbers = {name: x for name, x in values_of.items() if x.is_constant()}
    # A number that a component was built with is part of the model; parameters are those of the model itself.
    free = {v.symbol.name() for v in raw.parameters if "." not in v.symbol.name()} & numbers.keys()
    rest = {name: x for name, x in values_of.items() if name not in free}
    replaced = _close(rest, by_name, class_name)
    old = [by_name[name] for name in replaced]
    new = list(replaced.values())

    def substitute(expressions: list[Any]) -> list[Any]:
        return list(ca.substitute(expressions, old, new)) if old else expressions

    def limit(value: Any) -> float:
        return float(substitute(convert([value]))[0])

    def make(variable: Any, start: Any) -> Variable:
        name = variable.symbol.name()
        low, high = limit(variable.min), limit(variable.max)
        symbol = symbols.get(name)
        return Variable(
            name=name,
            symbol=by_name[name],
            unit=str(symbol.unit.value or "") if symbol else "",
            description=str(symbol.comment or "") if symbol else "",
            minimum=low if math.isfinite(low) else None,
            maximum=high if math.isfinite(high) else None,
            start=start,
        )

    for state in raw.states:
        if not bool(float(ca.MX(state.fixed).to_DM() if isinstance(state.fixed, ca.MX) else state.fixed)):
            raise CompileError(f"{class_name}: the state {state.symbol.name()} needs start and fixed=true")
    held = {*events.discrete, *events.truths}
    with_start = [*raw.states, *(v for v in raw.inputs if v.symbol.name() in events.discrete)]
    starts = substitute(convert([v.start for v in with_start])) if with_start else []
    made = [make(v, start) for v, start in zip(with_start, starts, strict=True)]
    n_states = len(raw.states)
    checks = tuple(
        Check(name, replaced[name], str(symbols[name].unit.value or ""), limit(v.min), limit(v.max))
        for v in raw.parameters
        if (name := v.symbol.name()) not in free
    )
    for check in checks:
        if check.expression.is_constant() and not check.minimum <= float(check.expression) <= check.maximum:
            raise CompileError(
                f"{class_name}: {check.name} = {float(check.expression)} is missing or out of limits"
            )
    return FlatModel(
        name=class_name,
        description=description,
        time=by_name[raw.time.name()],
        states=tuple(made[:n_states]),
        derivatives=tuple(by_name[v.symbol.name()] for v in raw.der_states),
        algebraics=tuple(make(v, None) for v in raw.alg_states),
        inputs=tuple(make(v, limit(v.start)) for v in raw.inputs if v.symbol.name() not in held),
        parameters=tuple(
            make(v, _value(numbers[name], name)) for v in raw.parameters if (name := v.symbol.name()) in free
        ),
        output_names=tuple(raw.outputs),
        residual=substitute([ca.vertcat(*convert(raw.equations))])[0],
        checks=tuple(check for check in checks if not check.expression.is_constant()),
        discrete=tuple(made[n_states:]),
        truths=tuple(by_name[name] for name in events.truths),
        events=events,
    )


def _is_scalar(variable: Any) -> bool:
    return all(dim is None for shape in variable.symbol._modelica_shape for dim in shape)


def _value(number: Any, name: str) -> float:
    value = float(number)
    if not math.isfinite(value):
        raise CompileError(f"the parameter {name} has no value; give it one")
    return value


def _close(bound: dict[str, Any], by_name: dict[str, Any], class_name: str) -> dict[str, Any]:
    """Replace bound names inside the bound expressions until only free names remain."""
    names = list(bound)
    symbols = [by_name[name] for name in names]
    expressions = list(bound.values())
    stacked = ca.vertcat(*symbols)
    for _ in range(len(names) + 1):
        if not names or not ca.depends_on(ca.vertcat(*expressions), stacked):
            return dict(zip(names, expressions, strict=True))
        expressions = list(ca.substitute(expressions, symbols, expressions))
    raise CompileError(f"{class_name}: parameters are bound to each other in a circle")

"""Parameters that are tied to others by an expression, as R2 = "3 * R1", with their units checked."""

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.foreign_text import quoted, shortened
from simulation.parameters import SumLimit
from simulation.units import Exponents, Unit, in_si

_OPERATORS: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_FUNCTIONS: Final[dict[str, Callable[..., float]]] = {
    "exp": math.exp,
    "log": math.log,
    "sqrt": math.sqrt,
    "abs": abs,
    "min": min,
    "max": max,
}
_LONGEST = 1000
_HINT = (
    "write sums, products, quotients and whole powers of parameters and numbers, and "
    f"{', '.join(_FUNCTIONS)} of them"
)


@dataclass(frozen=True)
class Tie:
    """A parameter of the FMU that follows from others.

    Attributes:
        name: The parameter.
        expression: Its value as a formula of other parameters, in SI units.
        factors: Size of the unit of each parameter in the expression, by name. [SI]
        factor: Size of the parameter's own unit. [SI]
    """

    name: str
    expression: str
    factors: tuple[tuple[str, float], ...]
    factor: float

    def value(self, values: Mapping[str, float]) -> float:
        """Return the parameter's value, NaN where there is none. [FMU's unit].

        Args:
            values: Values of the other parameters by name. [FMU's units]
        """
        in_si_units = {name: values[name] * factor for name, factor in self.factors}
        try:
            return float(_value(_tree(self.expression), in_si_units)) / self.factor
        except (ArithmeticError, TypeError, ValueError):
            return float("nan")


def tie(name: str, expression: str, known: set[str], fmu: FmuDescription) -> Tie:
    """Read an expression and check its names and units.

    Args:
        name: The parameter that is tied.
        expression: Its value as a formula of other parameters.
        known: Parameters that an expression may have: calibrated or held at a number.
        fmu: What the FMU says of itself.

    Raises:
        InputError: If the expression cannot be read, has another name, or another unit than the parameter.
    """
    where = f"tied.{shortened(name)} = {quoted(expression)}"
    if len(expression) > _LONGEST:
        raise InputError(f"{where} is longer than {_LONGEST} characters; shorten it")
    try:
        tree = _tree(expression)
    except (SyntaxError, ValueError, RecursionError):
        raise InputError(f"{where} is no expression; {_HINT}") from None
    names = sorted(_names(tree, where))
    for one in names:
        if one not in known:
            of = shortened(", ".join(sorted(known)), _LONGEST)
            raise InputError(f"{where}: {one} is neither calibrated nor fixed at a number; use one of: {of}")
    if not names:
        raise InputError(f"{where} has no parameter; write the number under [fixed]")
    units = {one: _unit(fmu, one) for one in (*names, name)}
    if None not in units.values():
        sizes = {one: unit.exponents for one, unit in units.items() if unit is not None}
        found = _exponents(tree, sizes, where)
        if found is not None and found != sizes[name]:
            raise InputError(
                f"{where}: is in {_written(found)}, and {name} in {fmu.variables[name].unit}; correct it"
            )
    factors = {one: 1.0 if unit is None else float(unit.factor) for one, unit in units.items()}
    return Tie(name, expression, tuple((one, factors[one]) for one in names), factors[name])


@cache
def _tree(expression: str) -> ast.expr:
    return ast.parse(expression.strip(), mode="eval").body


def _names(tree: ast.expr, where: str) -> set[str]:
    match tree:
        case ast.BinOp(left, op, right) if type(op) in _OPERATORS:
            if isinstance(op, ast.Pow) and not (
                isinstance(right, ast.Constant) and isinstance(right.value, int)
            ):
                raise InputError(f"{where}: {ast.unparse(right)} is no whole power; {_HINT}")
            return _names(left, where) | _names(right, where)
        case ast.UnaryOp(ast.USub(), operand):
            return _names(operand, where)
        case ast.Call(ast.Name(function), [_, *more] as arguments, []) if function in _FUNCTIONS:
            if bool(more) != (function in ("min", "max")):
                raise InputError(f"{where}: {function} has {len(arguments)} arguments; correct it")
            return set[str]().union(*(_names(one, where) for one in arguments))
        case ast.Constant(value) if isinstance(value, int | float) and not isinstance(value, bool):
            return set()
        case ast.Name() | ast.Attribute() | ast.Subscript():
            return {ast.unparse(tree)}
    raise InputError(f"{where}: {shortened(ast.unparse(tree))} is not understood; {_HINT}")


def _value(tree: ast.expr, values: Mapping[str, float]) -> float:
    match tree:
        case ast.BinOp(left, op, right):
            return _OPERATORS[type(op)](_value(left, values), _value(right, values))
        case ast.UnaryOp(_, operand):
            return -_value(operand, values)
        case ast.Call(ast.Name(function), arguments):
            return float(_FUNCTIONS[function](*(_value(one, values) for one in arguments)))
        case ast.Constant(int() | float() as value):
            return float(value)
    return values[ast.unparse(tree)]


def _exponents(tree: ast.expr, units: Mapping[str, Exponents], where: str) -> Exponents | None:
    """Return the unit of an expression; None of a bare number that is added, which has any."""
    match tree:
        case ast.BinOp(left, ast.Add() | ast.Sub(), right):
            one, other = (_exponents(side, units, where) for side in (left, right))
            if one is not None and other is not None and one != other:
                raise InputError(f"{where}: adds {_written(one)} and {_written(other)}; correct it")
            return one if other is None else other
        case ast.BinOp(left, ast.Pow(), ast.Constant(int(power))):
            base = _exponents(left, units, where) or ()
            return tuple((name, n * power) for name, n in base if power)
        case ast.BinOp(left, op, right):
            sign = -1 if isinstance(op, ast.Div) else 1
            powers = dict(_exponents(left, units, where) or ())
            for name, n in _exponents(right, units, where) or ():
                powers[name] = powers.get(name, 0) + sign * n
            return tuple(sorted((name, n) for name, n in powers.items() if n))
        case ast.UnaryOp(_, operand):
            return _exponents(operand, units, where)
        case ast.Call(ast.Name(function), arguments):
            return _of_function(function, [_exponents(one, units, where) for one in arguments], where)
        case ast.Constant():
            return None
    return units[ast.unparse(tree)]


def _of_function(function: str, units: Sequence[Exponents | None], where: str) -> Exponents | None:
    """Return the unit of a function of arguments with these units."""
    known = list(dict.fromkeys(one for one in units if one is not None))
    if len(known) > 1:
        raise InputError(f"{where}: {function} of {' and '.join(map(_written, known))}; correct it")
    if not known or function in ("abs", "min", "max"):
        return known[0] if known else None
    if function == "sqrt" and all(n % 2 == 0 for _, n in known[0]):
        return tuple((name, n // 2) for name, n in known[0])
    if known[0]:
        raise InputError(f"{where}: {function} of {_written(known[0])}; divide it by a value in that unit")
    return ()


def sum_limit(text: str, where: str) -> SumLimit:
    """Read a constraint: a weighted sum of parameters that stays below a number or another sum.

    Args:
        text: As "R1 < R2", "fA + fB <= 0.9" or "2 * a - b > 1".
        where: What names it, for messages.

    Raises:
        InputError: If it is none.
    """
    sides = re.split(r"(<=?|>=?|==?)", text)
    if len(sides) != 3 or len(text) > _LONGEST:
        raise InputError(f'{where} is no pair; write "R1 < R2" with two parameters, or a sum "fA + fB <= 1"')
    if sides[1].startswith("="):
        raise InputError(
            f"{where} makes one parameter follow from the others; take it out of [[parameters]] and write it "
            'under [tied], as fC = "1 - fA - fB", with "fA + fB <= 1" as the constraint'
        )
    small, large = (sides[0], sides[2]) if "<" in sides[1] else (sides[2], sides[0])
    weights = dict[str, float]()
    try:
        for sign, side in ((1.0, small), (-1.0, large)):
            for name, weight in _linear(_tree(side)).items():
                weights[name] = weights.get(name, 0.0) + sign * weight
    except (SyntaxError, ValueError, RecursionError, ArithmeticError):
        raise InputError(
            f"{where} is no pair and no sum; write numbers times parameters and sums of them. Of what the "
            "model shows, limits are at_least and at_most of an output"
        ) from None
    terms = tuple((name, weight) for name, weight in weights.items() if name and weight)
    if len(terms) < 2:
        raise InputError(
            f'{where} is no pair; write "R1 < R2" with two parameters, or narrow the bounds of one'
        )
    return SumLimit(terms, 0.0 - weights.get("", 0.0))


def _linear(tree: ast.expr) -> dict[str, float]:
    """Return the weights of names in a sum, and its number as that of ""; ValueError where it is none."""
    match tree:
        case ast.BinOp(left, ast.Add() | ast.Sub() as op, right):
            found, sign = _linear(left), 1.0 if isinstance(op, ast.Add) else -1.0
            for name, weight in _linear(right).items():
                found[name] = found.get(name, 0.0) + sign * weight
            return found
        case ast.BinOp(left, ast.Mult() | ast.Div() as op, right):
            one, other = _linear(left), _linear(right)
            if isinstance(op, ast.Mult) and not one.keys() - {""}:
                one, other = other, one
            if other.keys() - {""}:
                raise ValueError("a product of parameters")
            factor = other.get("", 0.0) if isinstance(op, ast.Mult) else 1.0 / other.get("", 0.0)
            return {name: weight * factor for name, weight in one.items()}
        case ast.UnaryOp(ast.USub(), operand):
            return {name: -weight for name, weight in _linear(operand).items()}
        case ast.Constant(int() | float() as value):
            return {"": float(value)}
        case ast.Name() | ast.Attribute() | ast.Subscript():
            return {ast.unparse(tree): 1.0}
    raise ValueError("no sum")


def _unit(fmu: FmuDescription, name: str) -> Unit | None:
    unit = fmu.variables[name].unit
    return in_si(unit, fmu.units) if unit else None


def _written(exponents: Exponents) -> str:
    return ".".join(f"{name}{'' if n == 1 else n}" for name, n in exponents) or "1"

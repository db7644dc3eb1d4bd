"""Parameters that are tied to others by an expression, as R2 = "3 * R1", with their units checked."""

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.foreign_text import quoted, shortened
from simulation.units import Exponents, Unit, in_si

_OPERATORS: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_LONGEST = 1000
_HINT = "write sums, products, quotients and whole powers of parameters and numbers"


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
        case ast.Constant():
            return None
    return units[ast.unparse(tree)]


def _unit(fmu: FmuDescription, name: str) -> Unit | None:
    unit = fmu.variables[name].unit
    return in_si(unit, fmu.units) if unit else None


def _written(exponents: Exponents) -> str:
    return ".".join(f"{name}{'' if n == 1 else n}" for name, n in exponents) or "1"

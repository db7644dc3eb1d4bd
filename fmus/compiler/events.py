"""Take events out of a flat Modelica class: what is left is a model whose discrete variables stand still."""

from dataclasses import dataclass, field
from typing import Any

from pymoca import ast

from fmus.compiler.settings import CompileError

_RELATIONS = ("<", "<=", ">", ">=")
# Operators of Modelica that no embedded model with events needs; a model with one is refused.
_NOT_UNDERSTOOD = ("sample", "initial", "terminal", "edge", "change", "noEvent", "smooth")


@dataclass(frozen=True)
class Branch:
    """One branch of a when: as its condition becomes true, discrete variables get new values.

    Attributes:
        when: Number of the when it belongs to; of the branches of one when, the first that becomes true acts.
        condition: Name of the variable that holds the condition.
        targets: New value of each variable that is set: name of the one, name of the variable that holds it.
    """

    when: int
    condition: str
    targets: dict[str, str]


@dataclass(frozen=True)
class EventNames:
    """Names of the variables that stand for events in a class after `take_out_events`.

    Attributes:
        discrete: Variables that only whens set; inputs of the class now.
        truths: Truth value of each relation that makes events, held between them; inputs of the class now.
        margins: By how much each relation holds, positive where it is true.
        values: What each relation is when it is looked at.
        branches: Branches of all whens.
    """

    discrete: tuple[str, ...] = ()
    truths: tuple[str, ...] = ()
    margins: tuple[str, ...] = ()
    values: tuple[str, ...] = ()
    branches: tuple[Branch, ...] = ()


def take_out_events(flat_class: Any) -> EventNames:
    """Replace relations and whens of a flat class by variables that are held between events.

    A relation becomes an input (its held truth value) and two variables, its margin and what it is now. A
    when becomes a variable for each condition and each new value. What it sets becomes an input.

    Args:
        flat_class: Class as pymoca flattens it; it is changed.

    Returns:
        Names of the new variables.

    Raises:
        CompileError: If the class has what is not understood.
    """
    return _Rewriting(flat_class).run()


@dataclass
class _Rewriting:
    flat_class: Any
    relations: dict[str, str] = field(default_factory=dict)
    added: list[Any] = field(default_factory=list)

    def run(self) -> EventNames:
        whens = [e for e in self.flat_class.equations if isinstance(e, ast.WhenEquation)]
        rest = [e for e in self.flat_class.equations if not isinstance(e, ast.WhenEquation)]
        discrete = self._discrete_variables(whens)
        for equation in rest:
            if not isinstance(equation, ast.Equation):
                raise self._error("an equation within if is not understood; write an if expression")
            equation.left, equation.right = self._hold(equation.left), self._hold(equation.right)
        branches = [
            self._branch(number, condition, block)
            for number, when in enumerate(whens)
            for condition, block in zip(when.conditions, when.blocks, strict=True)
        ]
        self.flat_class.equations = [*rest, *self.added]
        numbers = range(1, len(self.relations) + 1)
        return EventNames(
            discrete=discrete,
            truths=tuple(self.relations.values()),
            margins=tuple(f"$margin{k}" for k in numbers),
            values=tuple(f"$value{k}" for k in numbers),
            branches=tuple(branches),
        )

    def _error(self, message: str) -> CompileError:
        return CompileError(f"{self.flat_class.name}: {message}")

    def _discrete_variables(self, whens: list[Any]) -> tuple[str, ...]:
        actions = [action for when in whens for block in when.blocks for action in block]
        if not all(isinstance(action, ast.Equation) for action in actions):
            raise self._error("a when may hold `variable = expression` alone")
        names = [str(action.left) for action in actions]
        for name in names:
            symbol = self.flat_class.symbols[name]
            if "discrete" not in symbol.prefixes or getattr(symbol.fixed, "value", None) is not True:
                raise self._error(f"a when sets {name}: declare it as discrete, with start and fixed=true")
        for name in names:
            self.flat_class.symbols[name].prefixes = ["input"]
        return tuple(dict.fromkeys(names))

    def _branch(self, number: int, condition: Any, block: list[Any]) -> Branch:
        targets = {str(one.left): self._variable("action", self._hold(one.right)) for one in block}
        return Branch(number, self._variable("condition", self._hold(condition)), targets)

    def _variable(self, kind: str, expression: Any) -> str:
        """Add a variable that an equation sets to the expression."""
        name = f"${kind}{len(self.added) + 1}" if kind in {"action", "condition"} else kind
        self._symbol(name, [])
        self.added.append(ast.Equation(left=ast.ComponentRef(name=name), right=expression))
        return name

    def _symbol(self, name: str, prefixes: list[str]) -> None:
        order = 1 + max((symbol.order for symbol in self.flat_class.symbols.values()), default=0)
        real = ast.ComponentRef(name="Real")
        self.flat_class.symbols[name] = ast.Symbol(name=name, type=real, prefixes=prefixes, order=order)

    def _hold(self, node: Any) -> Any:
        """Replace the relations of an expression."""
        if isinstance(node, ast.IfExpression):
            raise self._error("if is not understood beside events; write a when")
        if not isinstance(node, ast.Expression):
            return node
        operator = str(node.operator)
        if operator in _NOT_UNDERSTOOD:
            raise self._error(f"{operator}() is not understood; write a condition on a variable or on time")
        if operator == "pre":
            # All branches see the values from before the event.
            return node.operands[0]
        if operator != "der":
            node.operands = [self._hold(operand) for operand in node.operands]
        return self._relation(node, operator) if operator in _RELATIONS else node

    def _relation(self, node: Any, operator: str) -> Any:
        key = str(node)
        if key not in self.relations:
            number = len(self.relations) + 1
            self.relations[key] = f"$truth{number}"
            self._symbol(self.relations[key], ["input"])
            ends = node.operands if operator in {">", ">="} else node.operands[::-1]
            self._variable(f"$margin{number}", ast.Expression(operator="-", operands=list(ends)))
            self._variable(f"$value{number}", node)
        return ast.ComponentRef(name=self.relations[key])

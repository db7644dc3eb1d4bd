"""Solve flat model equations for the derivatives and outputs, block by block."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import casadi as ca

from fmus.compiler.modelica import FlatModel, Variable
from fmus.compiler.settings import CompileError


@dataclass(frozen=True)
class Action:
    """One branch of a when, see `events.Branch`; targets are states and discrete variables by their place.

    Attributes:
        when: Number of its when.
        condition: True where not zero.
        values: New value by the target's place among states and discrete variables.
    """

    when: int
    condition: Any
    values: dict[int, Any]


@dataclass(frozen=True)
class Ode(FlatModel):
    """Explicit form of a model: der(x) = derivative(t, x, u, p), y = output(t, x, u, p), x(0) = start(p).

    All expressions are SX columns in the order of the variables. What stands still between events is u:
    inputs, discrete variables, and truth values of relations. The start is that of x and of the
    discrete variables.
    """

    outputs: tuple[Variable, ...]
    derivative: Any
    output: Any
    start: Any
    margins: Any
    relations: Any
    actions: tuple[Action, ...]

    @property
    def has_events(self) -> bool:
        """Whether anything happens at events."""
        return bool(self.truths or self.actions)

    @property
    def x(self) -> Any:
        """States, a column."""
        return column([v.symbol for v in self.states])

    @property
    def u(self) -> Any:
        """Inputs, discrete variables and truth values, a column."""
        return column([*(v.symbol for v in (*self.inputs, *self.discrete)), *self.truths])

    @property
    def p(self) -> Any:
        """Parameters, a column."""
        return column([v.symbol for v in self.parameters])


def column(expressions: list[Any]) -> Any:
    """Stack scalar expressions into a dense SX column."""
    return ca.densify(ca.vertcat(*expressions)) if expressions else ca.SX.zeros(0, 1)


def make_explicit(model: FlatModel) -> Ode:
    """Solve a flat model for its derivatives and outputs.

    The equations are sorted into the smallest blocks that can be solved one after another (block triangular
    form); each block must be linear in its own unknowns.

    Args:
        model: Flat model.

    Returns:
        The explicit form.

    Raises:
        CompileError: If equations are missing, superfluous or contradictory, or a block is nonlinear.
    """
    unknowns = [*model.derivatives, *(v.symbol for v in model.algebraics)]
    stacked = column(unknowns)
    residual = model.residual
    if residual.numel() != len(unknowns):
        raise CompileError(
            f"{model.name}: {residual.numel()} equations for {len(unknowns)} unknowns; look for open ends"
        )
    pattern = ca.jacobian_sparsity(residual, stacked)
    n_blocks, row_order, column_order, row_start, column_start, _, coarse = pattern.btf()
    if coarse[3] < len(unknowns):
        loose = ", ".join(unknowns[j].name() for j in column_order[: max(1, coarse[1])])
        raise CompileError(
            f"{model.name}: no equation determines {loose}; look for x = x or storages in parallel"
        )
    solved: dict[int, Any] = {}
    # CasADi calls the form upper triangular, but orders it so that a block needs only what earlier ones give.
    for block in range(n_blocks):
        rows = row_order[row_start[block] : row_start[block + 1]]
        columns = column_order[column_start[block] : column_start[block + 1]]
        equations = ca.vertcat(*(residual[i] for i in rows))
        if solved:
            known = column([unknowns[j] for j in solved])
            equations = ca.substitute(equations, known, column(list(solved.values())))
        solution = _solve_block(equations, [unknowns[j] for j in columns], model.name)
        solved.update(zip(columns, solution, strict=True))
    n_states = len(model.states)
    algebraic = {v.name: solved[n_states + i] for i, v in enumerate(model.algebraics)}
    declared = {v.name: v for v in (*model.algebraics, *model.states, *model.discrete)}
    values = {**algebraic, **{v.name: v.symbol for v in (*model.states, *model.discrete)}}
    right_side = ca.cse(
        column([*(solved[i] for i in range(n_states)), *(values[name] for name in model.output_names)])
    )
    return Ode(
        **vars(model),
        outputs=tuple(declared[name] for name in model.output_names),
        derivative=right_side[:n_states],
        output=right_side[n_states:],
        start=column([v.start for v in (*model.states, *model.discrete)]),
        margins=ca.cse(column([algebraic[name] for name in model.events.margins])),
        relations=ca.cse(column([algebraic[name] for name in model.events.values])),
        actions=_actions(model, algebraic),
    )


def _actions(model: FlatModel, algebraic: dict[str, Any]) -> tuple[Action, ...]:
    places = {v.name: place for place, v in enumerate((*model.states, *model.discrete))}
    return tuple(
        Action(
            branch.when,
            algebraic[branch.condition],
            {places[name]: algebraic[value] for name, value in branch.targets.items()},
        )
        for branch in model.events.branches
    )


def _solve_block(equations: Any, unknowns: list[Any], model_name: str) -> list[Any]:
    stacked = column(unknowns)
    matrix = ca.jacobian(equations, stacked)
    block_name = f"{model_name}: the equations of {', '.join(symbol.name() for symbol in unknowns)}"
    if ca.depends_on(matrix, stacked):
        raise CompileError(f"{block_name} are nonlinear in them; solve by hand or add a storage")
    at_zero = ca.substitute(equations, stacked, ca.SX.zeros(stacked.shape))
    indices = range(len(unknowns))
    rows = [[matrix[i, j] for j in indices] for i in indices]
    return _eliminate(rows, [-at_zero[i] for i in indices], block_name)


def _eliminate(matrix: list[list[Any]], right: list[Any], block_name: str) -> list[Any]:
    """Gaussian elimination on expressions.

    A number is taken as pivot before an expression: in networks of conductances that leaves sums of
    conductances, which vanish for no sensible parameter.
    """
    n = len(right)
    free_rows, free_columns = list(range(n)), list(range(n))
    order: list[tuple[int, int]] = []
    for _ in range(n):
        pivot = _pivot(matrix, free_rows, free_columns)
        if pivot is None:
            raise CompileError(f"{block_name} contradict each other")
        row, col = pivot
        free_rows.remove(row)
        free_columns.remove(col)
        order.append(pivot)
        for i in free_rows:
            if _vanishes(matrix[i][col]):
                continue
            factor = matrix[i][col] / matrix[row][col]
            matrix[i] = [ca.simplify(a - factor * c) for a, c in zip(matrix[i], matrix[row], strict=True)]
            matrix[i][col] = ca.SX(0)
            right[i] = right[i] - factor * right[row]
    values: dict[int, Any] = {}
    for row, col in reversed(order):
        rest = right[row]
        for j, value in values.items():
            if not _vanishes(matrix[row][j]):
                rest = rest - matrix[row][j] * value
        values[col] = rest / matrix[row][col]
    return [values[j] for j in range(n)]


def _vanishes(expression: Any) -> bool:
    return bool(expression.is_zero()) or expression.nnz() == 0


def _pivot(matrix: list[list[Any]], rows: list[int], columns: list[int]) -> tuple[int, int] | None:
    there = [(i, j) for i in rows for j in columns if not _vanishes(matrix[i][j])]
    in_rows, in_columns = Counter(i for i, _ in there), Counter(j for _, j in there)

    def cost(place: tuple[int, int]) -> tuple[int, float, int]:
        entry, fill = matrix[place[0]][place[1]], in_rows[place[0]] * in_columns[place[1]]
        return (0, -abs(float(entry)), fill) if entry.is_constant() else (1, 0.0, fill)

    return min(there, key=cost, default=None)

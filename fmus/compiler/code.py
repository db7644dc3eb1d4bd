"""Write an explicit ODE as C: the functions of the model (model.c) and its numbers (model.h)."""

from typing import Any

import casadi as ca

from fmus.compiler.causal import Ode, column
from fmus.compiler.compile_error import CompileError
from fmus.compiler.filled import filled
from fmus.compiler.settings import BuildSettings


def write_code(ode: Ode, settings: BuildSettings) -> tuple[str, str]:
    """Generate the C code of a model.

    Args:
        ode: Explicit model.
        settings: Solver and its numbers.

    Returns:
        Texts of model.c and model.h.

    Raises:
        CompileError: If exact stepping is asked for a model that is not affine in its states.
    """
    functions = _functions(ode, exact=settings.solver == "exact")
    generator = ca.CodeGenerator("model.c", {"with_header": False, "with_export": False, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    # With the header's declarations, which hide the functions, whatever the compiler's flags.
    source = f'#include "model.h"\n\n{generator.dump()}'
    header = filled(
        "model.h.jinja",
        ode=ode,
        settings=settings,
        functions=functions,
        work=max(1, *(function.sz_w() for function in functions)),
        integer_work=max(1, *(function.sz_iw() for function in functions)),
    )
    return source, header


def _functions(ode: Ode, *, exact: bool) -> list[Any]:
    t, x, u, p = ode.time, ode.x, ode.u, ode.p
    dx, du, dp = (ca.SX.sym(name, symbol.numel()) for name, symbol in (("dx", x), ("du", u), ("dp", p)))
    arguments, seeds = ca.vertcat(x, u, p), ca.vertcat(dx, du, dp)
    functions = [
        ("model_derivatives", [t, x, u, p], [ode.derivative]),
        ("model_outputs", [t, x, u, p], [ode.output]),
        ("model_start", [p], [ode.start]),
        ("model_checks", [p], [column([check.expression for check in ode.checks])]),
        (
            "model_forward",
            [t, x, u, p, dx, du, dp],
            [ca.jtimes(ode.derivative, arguments, seeds), ca.jtimes(ode.output, arguments, seeds)],
        ),
        ("model_start_forward", [p, dp], [ca.jtimes(ode.start, p, dp)]),
    ]
    if ode.has_events:
        targets = [v.symbol for v in (*ode.states, *ode.discrete)]
        actions = [a.values.get(place, old) for a in ode.actions for place, old in enumerate(targets)]
        functions += [
            ("model_relations", [t, x, u, p], [ode.margins, ode.relations]),
            ("model_conditions", [t, x, u, p], [column([action.condition for action in ode.actions])]),
            ("model_actions", [t, x, u, p], [column(actions)]),
        ]
    if exact:
        matrix = ca.jacobian(ode.derivative, x)
        if ca.depends_on(matrix, x) or ca.depends_on(ode.derivative, t):
            raise CompileError(f'{ode.name}: not affine in its states; take solver = "rk4" in the build file')
        rest = ca.substitute(ode.derivative, x, ca.SX.zeros(x.shape))
        # CasADi stores by column, the C code reads by row.
        functions.append(("model_affine", [u, p], [ca.densify(matrix).T, rest]))
    return [
        ca.Function(name, list(ins), [ca.densify(out) for out in ca.cse(list(outs))])
        for name, ins, outs in functions
    ]


def write_data(ode: Ode, guid: str) -> str:
    """Write model_data.h: names, start values and limits, which only the FMI functions read.

    Args:
        ode: Explicit model.
        guid: GUID of the FMU.

    Returns:
        Text of the header.
    """
    kinds = {"INPUT": ode.inputs, "PARAMETER": ode.parameters, "STATE": ode.states, "OUTPUT": ode.outputs}
    targets = range(len(ode.states) + len(ode.discrete))
    sets = [int(place in action.values) for action in ode.actions for place in targets]
    return filled("model_data.h.jinja", ode=ode, guid=guid, kinds=kinds | {"CHECK": ode.checks}, sets=sets)

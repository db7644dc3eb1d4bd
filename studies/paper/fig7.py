"""Fig. 7: the error of the best surrogates on test sets that shrink around the middle of the box."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pelsvae.metrics import Errors, errors
from simulation.design import spread_design
from simulation.trajectories import Trajectories
from studies.paper.items import Origin, Shown, origin_of, write_size
from studies.paper.models import Chosen, chosen_settings, train_again
from studies.paper.plan import Plan
from studies.paper.published import N_IMPORTANT
from studies.physical_model import open_physical_model
from studies.reporting.drawing import LOG, Axis, Figure, Panel, Series, size_colors
from studies.stages.calibrate_stage import best_surrogate
from studies.stages.sensitivity_stage import fmu_sensitivity_stage
from studies.stages.simulate_stage import TEST_SEED
from studies.surrogate_model import SurrogateModel
from studies.task import Task
from studies.words.wording import axis_label, count

SPREADS = np.linspace(0.0, 1.0, 11)
"""The paper's delta. [1]"""

KINDS = {"important": "(a) six important parameters restricted", "all": "(b) all parameters restricted"}


@dataclass(frozen=True)
class SpreadSize(Chosen):
    """The errors of one training-set size.

    Args:
        training_s: duration of the training. [s]
        important: parameters that are restricted in (a).
        n_spread: rows of each test set.
        n_rows: rows of all narrower test sets.
        mae: by which parameters are restricted, per spread. [output's unit]
        p90: 90th percentile, the same. [output's unit]
    """

    training_s: float
    important: tuple[str, ...]
    n_spread: int
    n_rows: int
    mae: dict[str, tuple[float, ...]]
    p90: dict[str, tuple[float, ...]]


SIZE = SpreadSize


def run(plan: Plan) -> Shown:
    """Simulate the test sets and let the best of every size, trained again, predict them."""
    chosen = chosen_settings(plan)
    trained = {n: train_again(plan.task, n, one.settings) for n, one in chosen.items()}
    task = next(iter(trained.values()))[0]
    important = important_parameters(plan.task)
    judged, n_rows = _judge(task, plan.budget.n_spread, important)
    origin = origin_of(plan, plan.task, "fig7")
    found = [
        SpreadSize(
            **vars(chosen[n]),
            training_s=round(training_s, 1),
            important=important,
            n_spread=plan.budget.n_spread,
            n_rows=n_rows,
            mae={kind: tuple(one.mae for one in judged[n, kind]) for kind in KINDS},
            p90={kind: tuple(one.p90 for one in judged[n, kind]) for kind in KINDS},
        )
        for n, (_, training_s) in trained.items()
    ]
    for size in found:
        write_size(plan.folder("fig7"), origin, size.n_train, size)
    return shown(origin, found)


def important_parameters(task: Task) -> tuple[str, ...]:
    """Return the six parameters of largest first-order Sobol index, averaged over time (Fig. 5)."""
    indices = fmu_sensitivity_stage(task).result
    return tuple(indices.names[i] for i in indices.order()[:N_IMPORTANT])


def shown(origin: Origin, sizes: Sequence[SpreadSize]) -> Shown:
    """Return Fig. 7.

    Args:
        origin: where the errors come from.
        sizes: the errors by size, the smallest first.
    """
    return Shown(
        f"Fig. 7: MAE [{origin.unit}] over the spread δ of the test set",
        ("restricted", "n_train", *(f"δ = {spread:.1f}" for spread in SPREADS)),
        tuple((kind, size.n_train, *size.mae[kind]) for kind in KINDS for size in sizes),
        "spread.png",
        _figure(origin, sizes),
        origin.label,
        {"important": list(sizes[0].important)},
    )


def _figure(origin: Origin, sizes: Sequence[SpreadSize]) -> Figure:
    colors = size_colors([size.n_train for size in sizes])
    panels: list[Panel] = []
    for kind, name in KINDS.items():
        series = []
        for size in sizes:
            color, label = colors[size.n_train], f"n = {count(size.n_train)}"
            series.append(Series(label, color, SPREADS, size.mae[kind]))
            dots = {"strokeDash": [2, 3]}
            series.append(Series(f"{label}, P90", color, SPREADS, size.p90[kind], style=dots, is_named=False))
        y = Axis(axis_label("error", origin.unit), LOG)
        panels.append(
            Panel(name, Axis("spread δ of the test set [1]"), y, series, 300, has_legend=not panels)
        )
    title = "Fig. 7: error over the spread of the test set (— MAE, ··· 90th percentile)"
    return Figure(title, tuple(panels), columns=2, shows_names=True)


def _judge(task: Task, n: int, important: tuple[str, ...]) -> tuple[dict[tuple[int, str], list[Errors]], int]:
    """Return the errors at all spreads by size and kind, and the rows of the narrower test sets."""
    measurement, space = task.case.measurement, task.case.parameter_space
    true: dict[str, list[Trajectories]] = {kind: [] for kind in KINDS}
    asked: set[bytes] = set()
    with open_physical_model(task) as physical:
        for kind, columns in (("important", important), ("all", None)):
            for spread in SPREADS:
                # At 1 it is the test set that all trials are judged by, at 0 one point.
                theta = spread_design(space, n, float(spread), TEST_SEED, columns=columns)
                if spread < 1.0:  # the test set is counted where trials are judged by it
                    asked |= {row.tobytes() for row in theta}
                rows = physical.simulate(theta)
                true[kind].append(rows.take(~rows.failed))
    found = {}
    for n_train in task.profile.data.n_train:
        surrogate = best_surrogate(task, n_train)
        model = SurrogateModel(surrogate, space, measurement.output_names, measurement.time)
        for kind in KINDS:
            found[n_train, kind] = [
                errors(model.simulate(rows.theta).y, rows.y, measurement.error_scales) for rows in true[kind]
            ]
    return found, len(asked)

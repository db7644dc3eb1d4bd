"""Fig. 8 and sec. 3.3.2: is the calibration unique? Many starts of LS-TRF, and their optima in clusters."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.cluster.vq import kmeans2

from simulation.arrays import FloatArray, IntArray
from studies.paper.items import Cell, Shown
from studies.paper.plan import Plan
from studies.paper.published import FIG_8_BEST, FIG_8_MEAN
from studies.paper.table3 import SETTINGS, Start, computed
from studies.reporting.drawing import BETWEEN_BOUNDS, SERIES, Axis, Figure, Panel, Series
from studies.words.wording import square_of

N_CLUSTERS, N_LARGEST, BEST_SHARE = 10, 3, 0.05
"""The paper's numbers of centroids and of clusters shown, and its best 5 %."""


def run(plan: Plan) -> Shown:
    """Start LS-TRF as in the paper, and with SciPy's tolerance in the case's own scales."""
    task, n_starts = plan.task, plan.budget.n_starts
    paper = replace(SETTINGS["LS-TRF"], n_starts=n_starts, seed=task.profile.seed)
    # The second shows which optima are minima, and which searches stopped early.
    rows = (paper, replace(paper, in_unit_cube=True, tolerance=None))
    found = [(row.title, computed(task, row, plan.folder("fig8"))) for row in rows]
    space, starts = task.case.parameter_space, found[0][1]
    u = space.to_unit(np.array([one.theta for one in starts]))
    best = np.argsort([one.mse for one in starts], kind="stable")[: _n_best(len(starts))]
    unit = square_of(task.case.outputs[0].unit)
    return Shown(
        f"Fig. 8: optima of many starts; MSE [{unit}]",
        ("starts", "calls", "best MSE", "best 5 %", "median", "mean", "within 1 % of the best"),
        (
            *((title, *_numbers(starts)) for title, starts in found),
            ("the paper", None, None, FIG_8_BEST, None, FIG_8_MEAN, None),
        ),
        "optima.png",
        _figure(space.names, u, best),
        task.label,
    )


def _n_best(n_starts: int) -> int:
    return max(1, round(BEST_SHARE * n_starts))


def _numbers(starts: Sequence[Start]) -> tuple[Cell, ...]:
    mse = np.sort([one.mse for one in starts])
    means = (float(mse[: _n_best(len(mse))].mean()), float(np.median(mse)), float(mse.mean()))
    return sum(one.n_calls for one in starts), float(mse[0]), *means, int(np.sum(mse <= 1.01 * mse[0]))


def largest_clusters(u: FloatArray, n_clusters: int) -> list[FloatArray]:
    """Group points with k-means and return the groups, the largest first.

    Args:
        u: points. Shape (n, p).
        n_clusters: centroids; as many as there are different points at most.
    """
    n_clusters = min(n_clusters, len(np.unique(u, axis=0)))
    # "++" begins with centroids that lie at points, so that hardly a cluster stays empty.
    _, labels = kmeans2(u, n_clusters, iter=100, minit="++", rng=np.random.default_rng(0))
    return sorted((u[labels == k] for k in range(n_clusters)), key=len, reverse=True)


def _figure(names: Sequence[str], u: FloatArray, best: IntArray) -> Figure:
    """Show optima as lines over the parameters, each from its lower to its upper bound."""
    largest = largest_clusters(u, N_CLUSTERS)[:N_LARGEST]
    groups = {
        "(a) The largest clusters": {f"cluster {k + 1} ({len(one)})": one for k, one in enumerate(largest)},
        "(b) The best optima": {f"best 5 % ({len(best)})": u[best]},
    }
    x, y = Axis("", is_of_names=True), Axis("lower to upper bound [1]", BETWEEN_BOUNDS)
    thin = {"strokeWidth": 1.0, "opacity": 0.4}
    panels = [
        Panel(
            heading,
            x,
            y,
            [
                Series(
                    name, color, np.tile(names, len(group)), group.ravel(), style=thin,
                    line=np.repeat(np.arange(len(group)), len(names)),
                )
                for (name, group), color in zip(clusters.items(), SERIES, strict=False)
            ],
        )
        for heading, clusters in groups.items()
    ]  # fmt: skip
    return Figure(f"Fig. 8: {len(u)} optima of LS-TRF", tuple(panels), shows_names=True)

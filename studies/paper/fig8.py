"""Fig. 8 and sec. 3.3.2: is the calibration unique? Many starts of LS-TRF, and their optima in clusters."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.cluster.vq import kmeans2

from simulation.arrays import FloatArray, IntArray
from studies.paper.direct import Start, computed
from studies.paper.items import Cell, Shown
from studies.paper.plan import Plan
from studies.paper.published import FIG_8_BEST, FIG_8_MEAN
from studies.paper.table3 import SETTINGS
from studies.report.drawing import SERIES, drawing, legend, shortened
from studies.report.wording import difference_unit, squared

N_CLUSTERS, N_LARGEST, BEST_SHARE = 10, 3, 0.05
"""The paper's numbers of centroids and of clusters shown, and its best 5 %."""


def run(plan: Plan) -> Shown:
    """Start LS-TRF as in the paper, and with SciPy's tolerance in the case's own scales."""
    study, n_starts = plan.study, plan.budget.n_starts
    paper = replace(SETTINGS["LS-TRF"], n_starts=n_starts, seed=study.profile.seed)
    # The second tells minima from searches that stopped early.
    rows = (paper, replace(paper, in_unit_cube=True, tolerance=None))
    found = [(row.title, computed(study, row, plan.folder("fig8"))) for row in rows]
    space, starts = study.case.parameter_space, found[0][1]
    u = space.to_unit(np.array([one.theta for one in starts]))
    best = np.argsort([one.mse for one in starts], kind="stable")[: _n_best(len(starts))]
    unit = squared(difference_unit(study.case.outputs[0].unit))
    return Shown(
        f"Fig. 8: optima of many starts; MSE [{unit}]",
        ("starts", "calls", "best MSE", "best 5 %", "median", "mean", "within 1 % of the best"),
        (
            *((title, *_numbers(starts)) for title, starts in found),
            ("the paper", None, None, FIG_8_BEST, None, FIG_8_MEAN, None),
        ),
        lambda folder: [_picture(space.names, u, best, folder / "optima.png", study.label)],
    )


def _n_best(n_starts: int) -> int:
    return max(1, round(BEST_SHARE * n_starts))


def _numbers(starts: Sequence[Start]) -> tuple[Cell, ...]:
    mse = np.sort([one.mse for one in starts])
    means = (float(mse[: _n_best(len(mse))].mean()), float(np.median(mse)), float(mse.mean()))
    return sum(one.n_calls for one in starts), float(mse[0]), *means, int(np.sum(mse <= 1.01 * mse[0]))


def largest_clusters(u: FloatArray, n_clusters: int, seed: int = 0) -> list[FloatArray]:
    """Group points with k-means and return the groups, the largest first.

    Args:
        u: points. Shape (n, p).
        n_clusters: centroids; as many as there are different points at most.
        seed: seed of the first centroids.
    """
    n_clusters = min(n_clusters, len(np.unique(u, axis=0)))
    # "++" begins with centroids that lie at points, so that hardly a cluster stays empty.
    _, labels = kmeans2(u, n_clusters, iter=100, minit="++", rng=np.random.default_rng(seed))
    return sorted((u[labels == k] for k in range(n_clusters)), key=len, reverse=True)


def _picture(names: Sequence[str], u: FloatArray, best: IntArray, path: Path, note: str) -> Path:
    """Draw optima as lines over the parameters, each from its lower to its upper bound."""
    largest = largest_clusters(u, N_CLUSTERS)[:N_LARGEST]
    panels = {
        "(a) The largest clusters": {f"cluster {k + 1} ({len(one)})": one for k, one in enumerate(largest)},
        "(b) The best optima": {f"best 5 % ({len(best)})": u[best]},
    }
    labels = [shortened(name, 12) for name in names]
    with drawing(path, title=f"Fig. 8: {len(u)} optima of LS-TRF", height_in=6.4, footnote=note) as figure:
        for axes, (heading, groups) in zip(figure.subplots(2, 1), panels.items(), strict=True):
            for (name, group), color in zip(groups.items(), SERIES, strict=False):
                of_lines = [name, *[None] * (len(group) - 1)]
                axes.plot(group.T, color=color, linewidth=1.0, alpha=0.4, label=of_lines)
            axes.set_xticks(range(len(names)), labels, rotation=30, ha="right")
            axes.set_yticks([0.0, 0.5, 1.0], ["lower bound", "", "upper bound"])
            axes.set_title(heading)
            legend(axes)
    return path

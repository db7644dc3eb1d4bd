"""The benchmark in one picture: the best error over calls, a panel per family."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from fewest_calls.counted import Run
from fewest_calls.kept import Kept
from fewest_calls.problems import FAMILIES
from fewest_calls.table import order
from simulation.arrays import FloatArray

mpl.use("agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

# Excess over the best error known at which lines end: where runs do.
LEAST_EXCESS, MOST_EXCESS = 0.02, 1e4
BEYOND = 1e9
OURS = {"adaptive": "#c1121f", "adaptive, state equations": "#6a040f", "adaptive, 4 parallel": "#f08a5d"}
PEERS = ("#1f77b4", "#ff7f0e", "#2ca02c", "#9467bd", "#8c564b", "#17becf", "#7f7f7f", "#bcbd22")
STYLES = ("-", "--", ":")
TARGETS = (1.17, 1.02)


def draw(kept: Kept, path: Path) -> None:
    """Draw median and quartile band of every method into a file.

    Args:
        kept: The runs.
        path: Picture to write; its name says the format.
    """
    families = [f for f in FAMILIES if any(one.family == f for one in kept.problems.values())]
    # One of several numbers of parallel calls is enough.
    methods = [name for name in order(kept) if name in OURS or not name.endswith(("parallel", "own end"))]
    peers = [name for name in methods if name not in OURS]
    looks = {name: (PEERS[i % len(PEERS)], STYLES[i // len(PEERS)]) for i, name in enumerate(peers)}
    looks |= {name: (colour, "-") for name, colour in OURS.items()}
    n_columns = min(len(families) + 1, 3)
    n_rows = -(-(len(families) + 1) // n_columns)
    figure, axes = plt.subplots(
        n_rows, n_columns, figsize=(4.3 * n_columns, 3.2 * n_rows), squeeze=False, layout="constrained"
    )
    flat = list(axes.ravel())
    for ax, family in zip(flat, families, strict=False):
        _panel(ax, kept, family, methods, looks)
    for ax in flat[len(families) :]:
        ax.axis("off")
    handles = {h.get_label(): h for ax in flat for h in ax.get_legend_handles_labels()[0]}
    flat[len(families)].legend(
        [handles[name] for name in methods if name in handles],
        [name for name in methods if name in handles],
        loc="center",
        frameon=False,
        fontsize=8,
        ncols=2,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _panel(ax: Axes, kept: Kept, family: str, methods: list[str], looks: dict[str, tuple[str, str]]) -> None:
    for method in methods:
        runs = [
            (run, problem.best)
            for problem in kept.problems.values()
            if problem.family == family
            for run in kept.runs(problem.name, method)
        ]
        if not runs:
            continue
        calls = _calls(runs)
        excess = np.array([_excess(run, best, calls) for run, best in runs])
        low, middle, high = _quartiles(excess)
        is_ours, (colour, style) = method in OURS, looks[method]
        ax.plot(
            calls,
            middle,
            color=colour,
            lw=2.4 if is_ours else 1.1,
            zorder=3 if is_ours else 2,
            label=method,
            ls=style,
        )
        ax.fill_between(calls, low, high, color=colour, alpha=0.25 if is_ours else 0.08, lw=0, zorder=1)
    for target in TARGETS:
        ax.axhline(target - 1.0, color="0.5", lw=0.7, ls=":")
    ax.set(xscale="log", yscale="log", xlim=(3, None), ylim=(LEAST_EXCESS * 0.9, MOST_EXCESS))
    ax.set_yticks([0.02, 0.05, 0.17, 1.0, 9.0, 99.0, 999.0])
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{1.0 + value:.4g}"))
    ax.minorticks_off()
    ax.tick_params(labelsize=7)
    ax.set_title(FAMILIES[family], fontsize=9)
    ax.set_xlabel("model calls", fontsize=8)
    ax.set_ylabel("best MSE / best known", fontsize=8)


def _calls(runs: list[tuple[Run, float]]) -> FloatArray:
    """Return where the curves are drawn: until the last run has ended, one that arrived at its arrival."""
    ended = [run.max_calls if run.first(1.02 * best) is None else run.calls[-1] for run, best in runs]
    return np.unique(np.round(np.geomspace(1.0, max(ended), 200)))


def _excess(run: Run, best: float, calls: FloatArray) -> FloatArray:
    """Return best MSE / best known - 1 after each number of calls, infinite before the first."""
    place = np.searchsorted(np.array(run.calls), calls, side="right") - 1
    ratio = np.append(run.mse, np.inf)[place] / best - 1.0
    return np.asarray(np.maximum(ratio, LEAST_EXCESS))


def _quartiles(excess: FloatArray) -> FloatArray:
    """Return quartiles over the runs, values of runs each, NaN where there are none yet. Shape (3, c)."""
    quartiles = np.quantile(np.minimum(excess, BEYOND), [0.25, 0.5, 0.75], axis=0, method="nearest")
    quartiles[:, quartiles[1] >= BEYOND] = np.nan
    return np.asarray(quartiles)

"""The benchmark in one picture: the test error over the training-set size, a panel per problem."""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from surrogate_rivals.kept import Kept
from surrogate_rivals.methods import METHODS
from surrogate_rivals.problems import PROBLEMS
from surrogate_rivals.table import order

mpl.use("agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

OURS = ("#c1121f", "#f08a5d", "#7b2cbf")  # the last variant is the best one
RIVALS = ("#1f77b4", "#2ca02c", "#9467bd", "#8c564b", "#17becf", "#7f7f7f", "#bcbd22", "#3a5a40")


def draw(kept: Kept, path: Path) -> None:
    """Draw median and quartile band of every method into a file.

    Args:
        kept: The runs.
        path: Picture to write; its name says the format.
    """
    problems = [name for name in PROBLEMS if name in set(kept.problems())]
    n_columns = min(len(problems), 2)
    n_rows = -(-len(problems) // n_columns)
    figure, axes = plt.subplots(
        n_rows, n_columns, figsize=(5.2 * n_columns, 3.7 * n_rows + 0.6), squeeze=False, layout="constrained"
    )
    flat = list(axes.ravel())
    colours = _colours()
    for ax, problem in zip(flat, problems, strict=False):
        _panel(ax, kept, problem, colours)
    for ax in flat[len(problems) :]:
        ax.axis("off")
    handles = {str(h.get_label()): h for ax in flat for h in ax.get_legend_handles_labels()[0]}
    shown = [name for name in METHODS if name in handles]
    figure.legend(
        [handles[name] for name in shown],
        shown,
        loc="outside lower center",
        frameon=False,
        fontsize=8,
        ncols=4,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _colours() -> dict[str, str]:
    own = [name for name, method in METHODS.items() if method.is_ours]
    rivals = [name for name in METHODS if name not in own]
    return dict(zip(reversed(own), OURS, strict=False)) | {
        name: RIVALS[i % len(RIVALS)] for i, name in enumerate(rivals)
    }


def _panel(ax: Axes, kept: Kept, problem: str, colours: dict[str, str]) -> None:
    for method in order(kept, problem):
        if method not in METHODS:
            continue
        sizes = [size for size in kept.sizes(problem) if kept.runs(problem, method, size)]
        quartiles = np.array(
            [
                np.quantile([run.mae for run in kept.runs(problem, method, size)], [0.25, 0.5, 0.75])
                for size in sizes
            ]
        )
        is_ours, colour = METHODS[method].is_ours, colours.get(method, "0.3")
        ax.plot(
            sizes,
            quartiles[:, 1],
            color=colour,
            lw=2.4 if is_ours else 1.1,
            marker="o",
            ms=4.0 if is_ours else 2.5,
            zorder=3 if is_ours else 2,
            label=method,
        )
        ax.fill_between(
            sizes, quartiles[:, 0], quartiles[:, 2], color=colour, alpha=0.25 if is_ours else 0.1, lw=0
        )
    ax.set(xscale="log", yscale="log")
    ax.set_xticks(kept.sizes(problem))
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())
    ax.tick_params(labelsize=7, which="both")
    ax.grid(visible=True, lw=0.3, alpha=0.5)
    ax.set_title(PROBLEMS[problem].title, fontsize=9)
    ax.set_xlabel("training simulations n", fontsize=8)
    ax.set_ylabel(f"test MAE [{kept.units[problem]}]", fontsize=8)

"""The methods that are compared: ours by name, and each rival at its best settings on the same data.

Ours are trained once with their named settings. Every rival may choose by the validation set; its module says
what it chooses among. All learn principal coordinates that leave out a millionth of the variance, from
parameters both linear and logarithmic where that helps them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from pelsvae.config import VARIANTS
from surrogate_rivals.coordinates import Fitted
from surrogate_rivals.measured import Train
from surrogate_rivals.problems import Data


@dataclass(frozen=True)
class Method:
    """A way to learn a surrogate.

    Attributes:
        train: How.
        needs: Packages, as Python imports them.
        is_ours: Whether it is this project's.
        most_rows: Largest training set that it takes in minutes.
    """

    train: Train
    needs: tuple[str, ...] = ()
    is_ours: bool = False
    most_rows: int = 1_000_000

    @property
    def missing(self) -> list[str]:
        """Packages that are not installed."""
        return [name for name in self.needs if find_spec(name) is None]


def _when_wanted(module: str, function: str, **settings: Any) -> Train:
    """Return a training whose module, and the packages that it needs, are imported with its first run."""

    def train(data: Data, seed: int) -> Fitted:
        chosen: Callable[..., Fitted] = getattr(import_module(f"surrogate_rivals.{module}"), function)
        return chosen(data, seed, **settings)

    return train


METHODS: dict[str, Method] = {
    name: Method(_when_wanted("ours", "variant", name=name), is_ours=True) for name in VARIANTS
} | {
    "pca + gp": Method(
        _when_wanted("rivals_process", "gaussian_processes", is_warped=False), needs=("gpytorch",)
    ),
    "pca + gp, warped": Method(
        _when_wanted("rivals_process", "gaussian_processes", is_warped=True), needs=("gpytorch",)
    ),
    "pca + sparse pce": Method(_when_wanted("rivals_polynomial", "sparse_chaos"), needs=("openturns",)),
    "pca + kernel ridge": Method(_when_wanted("rivals_ridge", "kernel_ridge"), needs=("sklearn",)),
    "pca + boosted trees": Method(_when_wanted("rivals_trees", "boosted_trees"), needs=("sklearn",)),
    "pca + mlp": Method(_when_wanted("rivals_networks", "network")),
    "pca + deep ensemble": Method(_when_wanted("rivals_networks", "ensemble")),
    "autoemulate": Method(
        _when_wanted("rivals_autoemulate", "best_of_six"), needs=("autoemulate",), most_rows=512
    ),
}

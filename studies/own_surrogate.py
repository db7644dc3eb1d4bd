"""Surrogates of a user's own class: fitted, saved and loaded by it, and asked as those of `pelsvae`."""

import hashlib
import inspect
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pelsvae.epochs import EpochReport
from pelsvae.metrics import errors
from pelsvae.surrogate import require_positive
from simulation.errors import InputError
from studies.installed import installed_class
from studies.search_space import OwnConfig

DESCRIPTION = "surrogate.json"
METHODS = ("fit", "predict", "save", "load")
Rows = tuple[NDArray[np.float64], NDArray[np.float64]]


class OwnClass(Protocol):
    """What a class of surrogates has; its keywords are what a profile searches or fixes."""

    def fit(self, theta: NDArray[np.float64], y: NDArray[np.float64], seed: int) -> object:
        """Learn from rows theta (n, p) [per parameter] and y (n, t, k) [output's unit]."""

    def predict(self, theta: NDArray[np.float64]) -> ArrayLike:
        """Return the outputs (n, t, k) [output's unit] of rows theta (n, p) [per parameter]."""

    def save(self, folder: Path) -> object:
        """Write files into a folder."""

    @classmethod
    def load(cls, folder: Path) -> "OwnClass":
        """Return what was saved in a folder."""


def own_class(name: str) -> type[OwnClass]:
    """Return a class of surrogates by `module:Class`.

    Raises:
        InputError: there is no such class, or it lacks a method.
    """
    found = installed_class("tuning.surrogate", name)
    if missing := [one for one in METHODS if not callable(getattr(found, one, None))]:
        raise InputError(f"tuning.surrogate: {name} has no {missing[0]}(); it needs {', '.join(METHODS)}")
    return cast("type[OwnClass]", found)


def own_defaults(name: str, declared: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keywords of a class with their defaults.

    Args:
        name: the class.
        declared: the keywords that a profile searches or fixes.

    Raises:
        InputError: the class has no such keyword.
    """
    known = inspect.signature(own_class(name)).parameters
    if unknown := [one for one in declared if one not in known]:
        raise InputError(f"tuning.search.{unknown[0]}: {name} has no such keyword; it has {', '.join(known)}")
    return {key: one.default for key, one in known.items() if one.default is not one.empty}


@dataclass(frozen=True)
class OwnSurrogate:
    """A fitted surrogate of a user's class.

    Attributes:
        name: Its class, as `module:Class`.
        fitted: It itself.
        log_columns: Parameters on a logarithmic scale, which must be positive. Shape (q,).
        shape: Times and outputs of a prediction.
    """

    name: str
    fitted: OwnClass
    log_columns: NDArray[np.int64]
    shape: tuple[int, ...]
    n_threads: ClassVar[int] = 1

    def predict(self, theta: ArrayLike, *, n_jobs: int = 1) -> NDArray[np.float64]:
        """Predict the trajectories (n, t, k) [output's unit] of rows theta (n, p) [per parameter].

        Raises:
            ValueError: the class returns another shape, or a logarithmic parameter is not positive.
        """
        rows = np.array(theta, dtype=np.float64)
        require_positive(rows, self.log_columns)
        y = np.asarray(self.fitted.predict(rows), dtype=np.float64)
        if y.shape != (wanted := (len(rows), *self.shape)):
            raise ValueError(f"{self.name}.predict returned the shape {y.shape}; the outputs have {wanted}")
        return y

    def save(self, folder: Path) -> None:
        """Write the files of its class, and a description with their digests."""
        folder.mkdir(parents=True, exist_ok=True)
        self.fitted.save(folder)
        about = {"class": self.name, "log_columns": self.log_columns.tolist(), "shape": [*self.shape]}
        about["files"] = _digests(folder)
        (folder / DESCRIPTION).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class OwnFit:
    """A surrogate that was fitted, as `pelsvae.FitResult` has it."""

    surrogate: OwnSurrogate
    best_epoch: int = 1
    n_epochs: int = 1
    stop_reason: str = "fitted"


def fit_own(
    rows: Rows,
    validation: Rows | None,
    *,
    config: OwnConfig,
    seed: int,
    log_columns: NDArray[np.bool_],
    output_scales: NDArray[np.float64],
    on_epoch: Callable[[EpochReport], None],
) -> OwnFit:
    """Make a surrogate of a user's class and let it learn; one report follows, see `pelsvae.fit`."""
    made = own_class(config.name)(**config.to_dict())
    made.fit(*rows, seed)
    fitted = OwnSurrogate(config.name, made, np.flatnonzero(log_columns), rows[1].shape[1:])
    mae = math.nan
    if validation is not None:
        mae = float(errors(fitted.predict(validation[0]), validation[1], output_scales).mae)
    on_epoch(EpochReport(1, 1, math.nan, mae))
    return OwnFit(fitted)


def holds_own(folder: Path) -> bool:
    """Say whether a saved surrogate is of a user's class."""
    file = folder / DESCRIPTION
    return file.is_file() and '"class"' in file.read_text(encoding="utf-8", errors="replace")


def load_own(folder: Path) -> OwnSurrogate:
    """Load a surrogate by its own class.

    Raises:
        ValueError: a file is damaged.
        InputError: its class is not installed.
    """
    try:
        about = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
        name, files = str(about["class"]), dict(about["files"])
        columns, shape = np.array(about["log_columns"], dtype=np.int64), tuple(map(int, about["shape"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{folder / DESCRIPTION} is damaged ({error})") from error
    if _digests(folder) != files:
        raise ValueError(f"files in {folder} are not those that {DESCRIPTION} names")
    return OwnSurrogate(name, own_class(name).load(folder), columns, shape)


def _digests(folder: Path) -> dict[str, str]:
    files = sorted(one for one in folder.iterdir() if one.name != DESCRIPTION)
    return {one.name: hashlib.sha256(one.read_bytes()).hexdigest() for one in files}


class PyfuncOwn:
    """Such a surrogate behind MLflow's `predict`."""

    def __init__(self, folder: Path) -> None:
        self._surrogate = load_own(folder)

    def predict(self, model_input: Any, params: dict[str, Any] | None = None) -> NDArray[np.float64]:
        """Predict the outputs (n, t, k) [output's unit] of a frame with a column per parameter."""
        return self._surrogate.predict(np.asarray(model_input, dtype=np.float64))


def _load_pyfunc(data_path: str) -> PyfuncOwn:
    return PyfuncOwn(Path(data_path))

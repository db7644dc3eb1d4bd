"""The search space of a profile: which settings of the surrogate Optuna chooses, and from which values."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from pelsvae.config import VARIANTS, SurrogateConfig
from simulation.foreign_text import quoted

if TYPE_CHECKING:
    from optuna.trial import BaseTrial

STRICT = ConfigDict(extra="forbid", strict=False)
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Positive = Annotated[float, Field(gt=0.0)]
# What a double holds to the last digit; Optuna counts no further.
Bound = Annotated[int | float, Field(ge=-(2**53), le=2**53)]
Value = int | float | str | bool

FORMS = {"layers": "refined", "state-space": "state-space"}
"""Named form of the surrogate with each decoder, where the decoder is searched or fixed."""
OF_PCA_GP = ("n_scales", "degree", "n_members", "n_latent", "theta_features", "max_epochs")
OF_NETWORKS = (
    "decoder", "states", "n_stores", "sparsity", "n_latent", "n_hidden", "n_layers", "activation",
    "theta_features", "beta", "n_latent_samples", "n_prediction_samples", "detach_encoder", "batch_size",
    "learning_rate", "weight_decay", "optimizer", "schedule", "max_epochs", "patience",
)  # fmt: skip


@dataclass(frozen=True, config=STRICT)
class SearchParameter:
    """One hyperparameter as Optuna searches it.

    Args:
        kind: "int", "float" or "categorical".
        low: least value of a number.
        high: largest value of a number.
        log: whether a number is searched on a logarithmic scale.
        step: distance between the values of a number; not together with `log`.
        choices: values of a categorical one.
        when: the hyperparameter is searched only where these settings have these values (or one of a list).
            A setting named here is declared before.
    """

    kind: Literal["int", "float", "categorical"]
    low: Bound | None = None
    high: Bound | None = None
    log: bool = False
    step: Positive | None = None
    choices: tuple[Value, ...] = ()
    when: dict[str, Value | tuple[Value, ...]] = Field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind == "categorical":
            if not self.choices or self.low is not None or self.high is not None:
                raise ValueError("a categorical hyperparameter has choices and no low and high")
            return
        if self.low is None or self.high is None or self.choices:
            raise ValueError(f'a hyperparameter of kind "{self.kind}" has low and high and no choices')
        if self.low > self.high:
            raise ValueError(f"low = {self.low} is larger than high = {self.high}")
        if self.log and (self.low <= 0 or self.step is not None):
            raise ValueError("log = true needs low > 0 and no step")
        numbers = (self.low, self.high, self.step or 1)
        if self.kind == "int" and not all(float(v).is_integer() for v in numbers):
            raise ValueError('low, high and step of kind "int" are whole numbers')

    def is_asked(self, settings: Mapping[str, Any]) -> bool:
        """Say whether the hyperparameter is searched beside these settings."""
        return all(
            settings.get(name) in (wanted if isinstance(wanted, (tuple, list)) else (wanted,))
            for name, wanted in self.when.items()
        )

    def suggest(self, trial: "BaseTrial", name: str) -> Any:
        """Ask Optuna for a value."""
        if self.kind == "categorical":
            return trial.suggest_categorical(name, list(self.choices))
        low, high = self._bounds
        if self.kind == "int":
            return trial.suggest_int(name, int(low), int(high), step=int(self.step or 1), log=self.log)
        return trial.suggest_float(name, low, high, step=self.step, log=self.log)

    def nearest(self, value: Any) -> Any:
        """Return the value of the search that is nearest to a setting."""
        if self.kind == "categorical":
            return value if value in self.choices else self.choices[0]
        low, high = self._bounds
        value = min(max(value, low), high)
        if self.step is not None:
            value = low + round((value - low) / self.step) * self.step
        return round(value) if self.kind == "int" else float(value)

    def has(self, value: Any) -> bool:
        """Whether a value of any kind is one of the search."""
        if self.kind == "categorical":
            return value in self.choices
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        # Steps are summed up in floating point.
        return is_number and math.isclose(self.nearest(value), value, rel_tol=1e-9)

    @property
    def _bounds(self) -> tuple[float, float]:
        assert self.low is not None, "checked when it was declared"
        assert self.high is not None, "checked when it was declared"
        return float(self.low), float(self.high)

    def to_dict(self) -> dict[str, Any]:
        """Return what the profile declared, as JSON values."""
        return {name: value for name, value in asdict(self).items() if value not in (None, (), {}, False)}


SearchSpace = dict[str, SearchParameter]

NETWORK_SPACE: SearchSpace = {
    "n_latent": SearchParameter("int", low=8, high=128, log=True),
    "n_hidden": SearchParameter("int", low=64, high=256, log=True),
    "beta": SearchParameter("float", low=1.0, high=1000.0, log=True),
}
"""Searched for networks where the profile names no search space."""
LEARNING_RATE = SearchParameter("float", low=1.5e-3, high=6e-3, log=True)
STATE_SPACE: SearchSpace = {
    "states": SearchParameter("categorical", choices=("stores", "modes")),
    "n_stores": SearchParameter("int", low=3, high=6),
    "sparsity": SearchParameter("float", low=0.1, high=3.0, log=True),
    **NETWORK_SPACE,
    "learning_rate": LEARNING_RATE,
}
"""Searched for decoders that know the inputs where the profile names no search space."""
PCA_GP_SPACE: SearchSpace = {
    "n_scales": SearchParameter("int", low=1, high=4),
    "degree": SearchParameter("int", low=1, high=2),
}
"""Searched for PCA + GP where the profile names no search space."""


def is_own(surrogate: str) -> bool:
    """Say whether a surrogate is a class of a user's, named as `module:Class`."""
    return ":" in surrogate


@dataclasses.dataclass(frozen=True)
class OwnConfig:
    """The settings of one such surrogate.

    Attributes:
        name: Its class, as `module:Class`.
        keywords: What it is made with, sorted by name.
    """

    name: str
    keywords: tuple[tuple[str, Any], ...] = ()
    regressor: ClassVar[str] = "own"
    decoder: ClassVar[str] = ""
    device: ClassVar[str] = "cpu"
    n_threads: ClassVar[int] = 1
    max_epochs: ClassVar[int] = 1

    def __getattr__(self, name: str) -> Any:
        """Return a keyword."""
        if name in (known := dict(self.__dict__.get("keywords", ()))):
            return known[name]
        raise AttributeError(name)

    def replace(self, **changes: Any) -> "OwnConfig":
        """Return a copy with some keywords changed."""
        return OwnConfig(self.name, tuple(sorted({**self.to_dict(), **changes}.items())))

    def to_dict(self) -> dict[str, Any]:
        """Return the keywords."""
        return dict(self.keywords)


def space_of(surrogate: str, declared: SearchSpace | None) -> SearchSpace:
    """Return the search space of a surrogate: the declared one, else the usual one."""
    if declared is not None or is_own(surrogate):
        return declared or {}
    return {"pca-gp": PCA_GP_SPACE, "state-space": STATE_SPACE}.get(surrogate, NETWORK_SPACE)


def check_fixed(surrogate: str, fixed: Mapping[str, Any]) -> None:
    """Check settings that are not searched against the surrogate's.

    Raises:
        ValueError: a setting does not exist, has no effect, or does not take the value.
    """
    if is_own(surrogate):  # its class knows its keywords
        return
    known = OF_PCA_GP if surrogate == "pca-gp" else OF_NETWORKS
    for name in fixed:
        if name not in known:
            raise ValueError(
                f'fixed.{name} has no effect on surrogate "{surrogate}", which has {", ".join(known)}'
            )
    if fault := _fault(VARIANTS[form_of(surrogate, fixed)], **fixed):
        raise ValueError(f"fixed: {fault}")


def form_of(surrogate: str, settings: Mapping[str, Any]) -> str:
    """Return the named form whose other settings go with a decoder that is fixed."""
    return FORMS.get(str(settings.get("decoder")), surrogate) if surrogate in FORMS.values() else surrogate


def check_space(surrogate: str, space: SearchSpace, enqueued: Sequence[Mapping[str, Any]]) -> None:
    """Check a search space, and the configurations to begin with, against the surrogate's settings.

    Raises:
        ValueError: a setting does not exist, has no effect, or takes none of the values.
    """
    known = OF_PCA_GP if surrogate == "pca-gp" else OF_NETWORKS
    base, seen = VARIANTS.get(surrogate, VARIANTS["refined"]), set[str]()
    for name, parameter in ({} if is_own(surrogate) else space).items():
        if name not in known:
            raise ValueError(
                f'search.{name} has no effect on surrogate "{surrogate}", which has {", ".join(known)}'
            )
        for other in parameter.when:
            if other not in known:
                raise ValueError(f"search.{name}.when names {other}, which is no setting of the surrogate")
            if other in space and other not in seen:
                raise ValueError(f"search.{name}.when names {other}; declare {other} before {name}")
        seen.add(name)
        for value in parameter.choices or (parameter.low, parameter.high):
            # One of the forms takes it: what goes together with what is known in each trial alone.
            faults = [_fault(form, **{name: value}) for form in VARIANTS.values()]
            if all(faults):
                raise ValueError(f"search.{name}: {_fault(base, **{name: value})}")
    for place, settings in enumerate(enqueued):
        check_point(space, settings, f"enqueue[{place}].")


def check_point(space: SearchSpace, settings: Mapping[str, Any], prefix: str = "") -> None:
    """Check that settings are values of a search space. Optuna drops unknown names and takes values outside.

    Raises:
        ValueError: a name is not searched, or a value is none of the search; the name begins with `prefix`.
    """
    for name, value in settings.items():
        if name not in space:
            raise ValueError(f"{prefix}{quoted(name)} is not searched; add it to [tuning.search]")
        if not space[name].has(value):
            raise ValueError(f"{prefix}{name} = {quoted(value)} is no value of search.{name}")


def _fault(form: SurrogateConfig, **settings: Any) -> str:
    """Say why a form of the surrogate cannot take settings, nothing where it can."""
    try:
        form.replace(**settings)
    except ValueError as error:
        return str(error)
    return ""


def suggested(trial: "BaseTrial", space: SearchSpace, base: SurrogateConfig) -> dict[str, Any]:
    """Ask Optuna for the hyperparameters of a trial, in the order of their declaration."""
    return _chosen(space, base, lambda name, parameter: parameter.suggest(trial, name))


def default_point(space: SearchSpace, base: SurrogateConfig) -> dict[str, Any]:
    """Return the point of the search nearest to the surrogate's own settings: every study's first trial."""
    return _chosen(space, base, lambda name, parameter: parameter.nearest(getattr(base, name)))


def _chosen(
    space: SearchSpace, base: SurrogateConfig, value: Callable[[str, SearchParameter], Any]
) -> dict[str, Any]:
    chosen: dict[str, Any] = {}
    for name, parameter in space.items():
        if parameter.is_asked(base.to_dict() | chosen):
            chosen[name] = value(name, parameter)
    return chosen

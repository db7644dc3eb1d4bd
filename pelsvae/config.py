"""Every choice about the network and its training in one frozen record; imports nothing heavy."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast, get_args, get_type_hints

Activation = Literal["relu", "silu"]
ThetaFeatures = Literal["linear", "linear+log"]
Optimizer = Literal["adam", "adamw"]
Schedule = Literal["constant", "one-cycle"]
Device = Literal["auto", "cpu", "cuda"]
Regressor = Literal["network", "gaussian-process"]
Decoder = Literal["layers", "state-space"]
States = Literal["stores", "modes"]


@dataclass(frozen=True, kw_only=True)
class SurrogateConfig:
    """Settings of one PELS-VAE and of its training; the defaults are the faithful form.

    With regressor "gaussian-process" encoder and decoder are linear (`linear_vae`). What is said of layers,
    batches, draws, beta and optimizer then does not apply; n_latent is the most principal coordinates, and
    max_epochs the iterations of each search for the most probable kernel.

    Attributes:
        regressor: What leads from theta to the latent code: layers, or Gaussian processes.
        decoder: What leads from code and theta to the trajectory: layers, or a linear network of states that
            the recorded inputs drive (`state_space`). The latter takes no part in the settings of epochs and
            batches in the same way: an epoch is STEPS_PER_EPOCH optimizer steps, whatever the rows.
        states: Of a state-space decoder: "stores" with conductances between them, or damped "modes".
        n_stores: States of "stores", pairs of states of "modes".
        sparsity: What a power of a parameter costs in a state-space decoder, times the logarithm of its size.
        n_scales: Scales of a process's kernel, each with a length per feature.
        degree: Of the polynomial in a process's kernel, 1 or 2.
        n_members: Most processes with different likely kernels that are averaged; fewer where rows are many.
        n_latent: Dimension of the latent code z.
        n_hidden: Width of every hidden layer.
        n_layers: Linear layers in each of encoder, decoder and regressor (at least 2).
        activation: Between the linear layers.
        residual: Hidden layers add to what came before them, read theta each, and theta's features have
            learnt scales (`network`).
        theta_features: What the networks see of theta: standardized values, or also their logarithms.
        beta: Weight of the reconstruction term, Eq. 4; the reverse of its use in a beta-VAE.
        n_latent_samples: L of Eq. 4, decoded samples averaged in the training loss.
        n_prediction_samples: L of Eq. 7, decoded samples averaged in a prediction.
        detach_encoder: Stop the gradient of the regression terms (Eq. 5) before the encoder. Eq. 5 is
            minimized over all three networks, hence False.
        batch_size: Rows per optimizer step; a smaller training set is one batch.
        learning_rate: Of the optimizer; the peak of a one-cycle schedule.
        weight_decay: Decoupled for "adamw"; "adam" takes none.
        optimizer: Update rule.
        schedule: Course of the learning rate over max_epochs.
        max_epochs: Passes over the training set at most.
        patience: Epochs without a better validation error after which training stops.
        validate_every: Epochs from one validation (and report) to the next.
        device: Where the network lives; "auto" takes CUDA where there is one.
        n_threads: CPU threads of torch during training and prediction; None leaves the process's setting.
    """

    regressor: Regressor = "network"
    decoder: Decoder = "layers"
    states: States = "stores"
    # Three or four fit an office alike (docs/notes/adaptive-search.md, A hidden network).
    n_stores: int = 4
    sparsity: float = 1.0
    # Two scales cost 3 to 7 % more error at n = 1,024 (docs/notes/surrogates.md).
    n_scales: int = 3
    # A quadratic part beside the linear one: 0.458 instead of 0.480 K on the office at n = 64.
    degree: int = 2
    # Half as many members cost 1 to 2 % more error, at most 7 %.
    n_members: int = 16
    n_latent: int = 64
    n_hidden: int = 128
    n_layers: int = 4
    activation: Activation = "relu"
    residual: bool = False
    theta_features: ThetaFeatures = "linear"
    beta: float = 100.0
    n_latent_samples: int = 1
    n_prediction_samples: int = 16
    detach_encoder: bool = False
    batch_size: int = 256
    learning_rate: float = 1e-3
    weight_decay: float = 0.0
    optimizer: Optimizer = "adam"
    schedule: Schedule = "constant"
    max_epochs: int = 3000
    patience: int = 300
    validate_every: int = 20
    device: Device = "auto"
    n_threads: int | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be trained.

        Raises:
            ValueError: A setting has the wrong type or lies outside its range.
        """
        for name, allowed in _allowed().items():
            _check_type(name, getattr(self, name), allowed)
        for name in (
            "n_latent", "n_hidden", "n_latent_samples", "n_prediction_samples",
            "batch_size", "max_epochs", "patience", "validate_every", "n_scales", "n_members", "n_stores",
        ):  # fmt: skip
            if getattr(self, name) < 1:
                raise ValueError(f"{name} = {getattr(self, name)} must be at least 1")
        if self.n_layers < 2:
            raise ValueError(f"n_layers = {self.n_layers} must be at least 2")
        if self.degree not in (1, 2):
            raise ValueError(f"degree = {self.degree} must be 1 or 2")
        if self.n_threads is not None and self.n_threads < 1:
            raise ValueError(f"n_threads = {self.n_threads} must be at least 1, or None")
        for name in ("beta", "learning_rate", "sparsity"):
            if not 0.0 < getattr(self, name) < float("inf"):
                raise ValueError(f"{name} = {getattr(self, name)} must be positive and finite")
        if not 0.0 <= self.weight_decay < float("inf"):
            raise ValueError(f"weight_decay = {self.weight_decay} must not be negative")
        # In Adam a decay would be divided by the second moment: another setting (Loshchilov and Hutter 2019).
        if self.optimizer == "adam" and self.weight_decay != 0.0:
            raise ValueError("weight_decay belongs to optimizer 'adamw'; set it to 0 for 'adam'")

    def replace(self, **changes: Any) -> "SurrogateConfig":
        """Return a copy with some settings changed.

        Args:
            changes: Settings by name.

        Returns:
            The changed copy.

        Raises:
            ValueError: A name is unknown or a value impossible.
        """
        return self.from_dict({**self.to_dict(), **changes})

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain values that JSON can hold."""
        return {name: getattr(self, name) for name in _allowed()}

    @staticmethod
    def from_dict(settings: Mapping[str, Any]) -> "SurrogateConfig":
        """Build a config from plain values; what is not named keeps its default.

        Args:
            settings: Values by name, as `to_dict` writes them.

        Returns:
            The config.

        Raises:
            ValueError: A name is unknown or a value impossible.
        """
        known = _allowed().keys()
        unknown = sorted(set(settings) - known)
        if unknown:
            raise ValueError(f"unknown surrogate settings {unknown}; known are {sorted(known)}")
        return SurrogateConfig(**settings)


@functools.cache
def _allowed() -> dict[str, tuple[object, ...]]:
    """Return the words, or else the types, that the annotation of each setting allows."""
    hints = get_type_hints(SurrogateConfig)
    allowed = {name: get_args(hint) or (hint,) for name, hint in hints.items()}
    # A profile writes 1 for 1.0.
    return {name: (*one, int) if float in one else one for name, one in allowed.items()}


def _check_type(name: str, value: object, allowed: tuple[object, ...]) -> None:
    """Raise ValueError where a value is none that is allowed."""
    if not isinstance(allowed[0], type):
        if value not in allowed:
            raise ValueError(f"{name} = {value!r} must be one of {[*allowed]}")
        return
    kinds = cast("tuple[type, ...]", allowed)
    # bool is a subclass of int, so isinstance alone would take True for a number.
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        raise ValueError(f"{name} = {value!r} must be {' or '.join(kind.__name__ for kind in kinds)}")


VARIANTS: dict[str, SurrogateConfig] = {
    "paper": SurrogateConfig(),
    "refined": SurrogateConfig(
        n_latent=32,
        n_hidden=192,
        # Six residual layers of width 192 err 25 % less at n = 256 than three of 256 (docs/paper.md).
        n_layers=6,
        # With tanh the error was 60 % larger.
        activation="silu",
        residual=True,
        theta_features="linear+log",
        beta=10.0,
        n_prediction_samples=8,
        # Batches of 64 and 300 epochs instead of 256 and 600: 5 % less error in the same time.
        batch_size=64,
        learning_rate=4e-3,
        # 0.1 gave the same error, 1 gave 5 % more.
        weight_decay=0.3,
        optimizer="adamw",
        schedule="one-cycle",
        max_epochs=300,
        # All epochs: with a one-cycle schedule an error that stands still early says little.
        patience=300,
    ),
    "state-space": SurrogateConfig(
        decoder="state-space",
        n_latent=16,
        n_hidden=96,
        n_layers=3,
        activation="silu",
        residual=True,
        theta_features="linear+log",
        beta=6.0,
        n_prediction_samples=1,
        batch_size=64,
        learning_rate=3e-3,
        optimizer="adamw",
        schedule="one-cycle",
        # The steps of 300 epochs of 8 steps; twice as many halve the error of 2,000 rows.
        max_epochs=300,
        patience=300,
    ),
    "pca-gp": SurrogateConfig(
        regressor="gaussian-process",
        n_latent=256,
        theta_features="linear+log",
        max_epochs=40,
        patience=40,
    ),
}
"""Named forms of the same Eq. 3-7: "paper" as published, "refined" with what was found to help the networks,
"state-space" with a decoder that knows the inputs,
"pca-gp" with principal components and Gaussian processes between them, the baseline."""

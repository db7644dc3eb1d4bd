"""How a surrogate learns: the physics-enhanced latent space variational autoencoder (PELS-VAE).

`fit` trains a `Surrogate` from parameters and trajectories; its `FitResult` says how. A `SurrogateConfig`
holds all settings, `VARIANTS` the named ones. `save_surrogate` writes a surrogate to a folder and
`load_surrogate` reads it. A training that diverges raises `TrainingDiverged`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pelsvae.config import VARIANTS as VARIANTS
    from pelsvae.config import SurrogateConfig as SurrogateConfig
    from pelsvae.epochs import TrainingDiverged as TrainingDiverged
    from pelsvae.surrogate import Surrogate as Surrogate
    from pelsvae.surrogate_files import load_surrogate as load_surrogate
    from pelsvae.surrogate_files import save_surrogate as save_surrogate
    from pelsvae.training import FitResult as FitResult
    from pelsvae.training import fit as fit

_MODULES = {
    "FitResult": "training",
    "Surrogate": "surrogate",
    "SurrogateConfig": "config",
    "TrainingDiverged": "epochs",
    "VARIANTS": "config",
    "fit": "training",
    "load_surrogate": "surrogate_files",
    "save_surrogate": "surrogate_files",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    """Import what is public when it is first used: torch takes seconds."""
    if name in _MODULES:
        return getattr(import_module(f"pelsvae.{_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names, for tab completion."""
    return sorted({*globals(), *__all__})

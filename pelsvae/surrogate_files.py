"""The two files of a saved surrogate: weights.npz (arrays, no pickle) and surrogate.json (the rest)."""

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from pelsvae.config import Device, SurrogateConfig
from pelsvae.device import resolve_device
from pelsvae.kernel import Kernel
from pelsvae.linear_network.drive import Drive
from pelsvae.linear_vae import LinearVae
from pelsvae.mean_surrogate import MeanSurrogate
from pelsvae.network import LayersVae, PelsVae
from pelsvae.standardize import OutputStandardizer, ThetaStandardizer
from pelsvae.state_space import StateSpaceVae
from pelsvae.surrogate import Surrogate

WEIGHTS = "weights.npz"
DESCRIPTION = "surrogate.json"
_FORMAT, _FORMAT_OF_MEANS = 1, 2
_CHECKSUM = "checksum"
_DRIVE = "drive."  # prefix of what drives the model
_NETWORK = "network."  # prefix of the weights among the arrays


def save_surrogate(surrogate: Surrogate | MeanSurrogate, folder: Path) -> None:
    """Write both files without pickle, the description last: it has the checksum of the weights and its own.

    Args:
        surrogate: What to save.
        folder: Made if it is missing; holds all that `load_surrogate` needs, wherever it is moved.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if isinstance(surrogate, MeanSurrogate):
        each = [_arrays(one) for one in surrogate.parts]
        arrays = {f"{k}/{name}": value for k, one in enumerate(each) for name, value in one.items()}
        configs = [one.config.to_dict() for one in surrogate.parts]
        about = {"format": _FORMAT_OF_MEANS, "configs": configs, "shares": [*surrogate.shares]}
    else:
        arrays, about = _arrays(surrogate), {"format": _FORMAT, "config": surrogate.config.to_dict()}
    # Pickle would run code from a file that may come from a stranger.
    np.savez(folder / WEIGHTS, allow_pickle=False, **arrays)
    digest = hashlib.sha256((folder / WEIGHTS).read_bytes()).hexdigest()
    description = {**about, "weights_sha256": digest}
    description[_CHECKSUM] = _checksum(description)
    (folder / DESCRIPTION).write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")


def _arrays(surrogate: Surrogate) -> dict[str, npt.NDArray[Any]]:
    """Return all arrays of a surrogate by name."""
    arrays: dict[str, npt.NDArray[Any]] = {
        "eps": surrogate.eps.cpu().numpy(),
        "theta.log_columns": surrogate.theta_standardizer.log_columns,
        "theta.mean": surrogate.theta_standardizer.mean,
        "theta.deviation": surrogate.theta_standardizer.deviation,
        "output.mean": surrogate.output_standardizer.mean,
        "output.deviation": surrogate.output_standardizer.deviation,
    }
    if isinstance(surrogate.network, StateSpaceVae):
        arrays |= {_DRIVE + name: value for name, value in surrogate.network.drive.to_arrays().items()}
    for name, value in surrogate.network.state_dict().items():
        arrays[_NETWORK + name] = value.cpu().numpy()
    return arrays


def load_surrogate(folder: Path, device: Device = "auto") -> Surrogate | MeanSurrogate:
    """Read both files and check them against each other; predictions on the same device are the same bits.

    Args:
        folder: Where they lie.
        device: Where to put the network.

    Returns:
        The surrogate, or the mean of surrogates that was saved.

    Raises:
        FileNotFoundError: One of the files is missing.
        ValueError: A file is damaged, or the two do not belong together.
    """
    for name in (DESCRIPTION, WEIGHTS):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"no surrogate in {folder}: {name} is missing; train or copy it again")
    try:
        configs, shares, digest = _read_description(folder / DESCRIPTION)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{folder / DESCRIPTION} is damaged ({error}); train or copy it again") from error
    # Read once: the bytes that are loaded are those that were checked.
    content = (folder / WEIGHTS).read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise ValueError(
            f"{folder / WEIGHTS} is damaged or not the one that {DESCRIPTION} names; train or copy both again"
        )
    try:
        # Object arrays are refused.
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        on = resolve_device(device)
        if not shares:
            return _assembled(configs[0], arrays, on)
        each = [_part(arrays, f"{k}/") for k in range(len(configs))]
        parts = [_assembled(config, own, on) for config, own in zip(configs, each, strict=True)]
        return MeanSurrogate(tuple(parts), shares)
    except (KeyError, RuntimeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{folder / WEIGHTS} does not fit {DESCRIPTION}: {error}") from error


def _part(arrays: dict[str, npt.NDArray[Any]], prefix: str) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}


def _read_description(path: Path) -> tuple[list[SurrogateConfig], tuple[float, ...], str]:
    """Return the config of each part, the shares of a mean (none of a single one), the weights' digest."""
    read = json.loads(path.read_text(encoding="utf-8"))
    # Earlier versions wrote none.
    if not isinstance(read, dict) or read.pop(_CHECKSUM, None) not in (None, _checksum(read)):
        raise ValueError("it is not as it was written")
    digest = str(read["weights_sha256"])
    if read["format"] == _FORMAT:
        return [SurrogateConfig.from_dict(read["config"])], (), digest
    if read["format"] != _FORMAT_OF_MEANS:
        raise ValueError(f"format {read['format']!r}, this version reads {_FORMAT} and {_FORMAT_OF_MEANS}")
    configs, shares = [*map(SurrogateConfig.from_dict, read["configs"])], tuple(map(float, read["shares"]))
    if len(configs) != len(shares) or not shares or abs(sum(shares) - 1.0) > 1e-6 or min(shares) < 0.0:
        raise ValueError(f"{len(configs)} surrogates with the shares {list(shares)}")
    return configs, shares, digest


def _checksum(description: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(description, sort_keys=True).encode()).hexdigest()


def _assembled(
    config: SurrogateConfig, arrays: dict[str, npt.NDArray[Any]], device: torch.device
) -> Surrogate:
    """Put the pieces together; KeyError or RuntimeError where they do not fit."""
    theta = ThetaStandardizer(arrays["theta.log_columns"], arrays["theta.mean"], arrays["theta.deviation"])
    output = OutputStandardizer(arrays["output.mean"], arrays["output.deviation"])
    eps = torch.from_numpy(arrays["eps"])
    learnt = {name: torch.from_numpy(array) for name, array in _part(arrays, _NETWORK).items()}
    network: PelsVae | LinearVae
    if config.regressor == "network":
        # Any generator will do, as the next line replaces what it drew.
        if config.decoder == "state-space":
            drive = Drive.from_arrays(_part(arrays, _DRIVE))
            network = StateSpaceVae(theta, output, drive, config, torch.Generator())
            device = torch.device("cpu")
        else:
            network = LayersVae(theta.n_features, output.mean.size, config, torch.Generator()).to(eps.dtype)
        network.load_state_dict(learnt)
    else:
        kernel = Kernel(theta.n_features, config.n_scales, config.degree)
        network = LinearVae(kernel, learnt)
    return Surrogate(config, network.to(device).eval(), eps.to(device), theta, output)

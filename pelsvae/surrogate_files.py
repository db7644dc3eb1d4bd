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
from pelsvae.network import LayersVae, PelsVae
from pelsvae.standardize import OutputStandardizer, ThetaStandardizer
from pelsvae.state_space import StateSpaceVae
from pelsvae.surrogate import Surrogate

WEIGHTS = "weights.npz"
DESCRIPTION = "surrogate.json"
_FORMAT = 1
_DRIVE = "drive."  # prefix of what drives the model
_NETWORK = "network."  # prefix of the weights among the arrays


def save_surrogate(surrogate: Surrogate, folder: Path) -> None:
    """Write both files without pickle, the description last: it has the checksum of the weights.

    Args:
        surrogate: What to save.
        folder: Made if it is missing; holds all that `load_surrogate` needs, wherever it is moved.
    """
    folder.mkdir(parents=True, exist_ok=True)
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
    # Pickle would run code from a file that may come from a stranger.
    np.savez(folder / WEIGHTS, allow_pickle=False, **arrays)
    description = {
        "format": _FORMAT,
        "config": surrogate.config.to_dict(),
        "weights_sha256": hashlib.sha256((folder / WEIGHTS).read_bytes()).hexdigest(),
    }
    (folder / DESCRIPTION).write_text(json.dumps(description, indent=2) + "\n", encoding="utf-8")


def load_surrogate(folder: Path, device: Device = "auto") -> Surrogate:
    """Read both files and check them against each other; predictions on the same device are the same bits.

    Args:
        folder: Where they lie.
        device: Where to put the network.

    Returns:
        The surrogate.

    Raises:
        FileNotFoundError: One of the files is missing.
        ValueError: A file is damaged, or the two do not belong together.
    """
    for name in (DESCRIPTION, WEIGHTS):
        if not (folder / name).is_file():
            raise FileNotFoundError(f"no surrogate in {folder}: {name} is missing; train or copy it again")
    try:
        config, digest = _read_description(folder / DESCRIPTION)
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
        return _assembled(config, arrays, resolve_device(device))
    except (KeyError, RuntimeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{folder / WEIGHTS} does not fit {DESCRIPTION}: {error}") from error


def _read_description(path: Path) -> tuple[SurrogateConfig, str]:
    """Return config and the digest of the weights."""
    read = json.loads(path.read_text(encoding="utf-8"))
    if read["format"] != _FORMAT:
        raise ValueError(f"format {read['format']!r}, this version reads {_FORMAT}")
    return SurrogateConfig.from_dict(read["config"]), str(read["weights_sha256"])


def _assembled(
    config: SurrogateConfig, arrays: dict[str, npt.NDArray[Any]], device: torch.device
) -> Surrogate:
    """Put the pieces together; KeyError or RuntimeError where they do not fit."""
    theta = ThetaStandardizer(arrays["theta.log_columns"], arrays["theta.mean"], arrays["theta.deviation"])
    output = OutputStandardizer(arrays["output.mean"], arrays["output.deviation"])
    eps = torch.from_numpy(arrays["eps"])
    learnt = {
        name.removeprefix(_NETWORK): torch.from_numpy(array)
        for name, array in arrays.items()
        if name.startswith(_NETWORK)
    }
    network: PelsVae | LinearVae
    if config.regressor == "network":
        # Any generator will do, as the next line replaces what it drew.
        if config.decoder == "state-space":
            given = {k.removeprefix(_DRIVE): v for k, v in arrays.items() if k.startswith(_DRIVE)}
            network = StateSpaceVae(theta, output, Drive.from_arrays(given), config, torch.Generator())
            device = torch.device("cpu")
        else:
            network = LayersVae(theta.n_features, output.mean.size, config, torch.Generator()).to(eps.dtype)
        network.load_state_dict(learnt)
    else:
        kernel = Kernel(theta.n_features, config.n_scales, config.degree)
        network = LinearVae(kernel, learnt)
    return Surrogate(config, network.to(device).eval(), eps.to(device), theta, output)

"""What MLflow calls to open a registered surrogate; needs pelsvae, NumPy and pandas, nothing else of ours."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pelsvae.surrogate_files import load_surrogate

if TYPE_CHECKING:
    import pandas as pd


class PyfuncSurrogate:
    """A surrogate behind MLflow's `predict`.

    Args:
        folder: folder of a saved surrogate.
    """

    def __init__(self, folder: Path) -> None:
        self._surrogate = load_surrogate(folder, device="cpu")

    def predict(
        self, model_input: "pd.DataFrame", params: dict[str, Any] | None = None
    ) -> NDArray[np.float64]:
        """Predict the outputs.

        Args:
            model_input: one column per parameter, in the signature's order. Shape (n, p).
            params: not used; part of MLflow's interface.

        Returns:
            Outputs. Shape (n, t, k). [output's unit]
        """
        return self._surrogate.predict(np.asarray(model_input, dtype=np.float64))


def _load_pyfunc(data_path: str) -> PyfuncSurrogate:
    return PyfuncSurrogate(Path(data_path))

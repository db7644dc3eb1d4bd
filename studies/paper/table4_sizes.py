"""What Table 4 and Fig. 9 are drawn from: every calibration, one JSON file per size."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies.paper.models import Settings
from studies.paper.size_files import Origin, read_sizes


@dataclass(frozen=True)
class SeedCalibration:
    """One calibration: a training design, a surrogate, a screening and two polishes from the same point.

    An MSE that is None could not be simulated. [first output's unit squared]

    Args:
        seed: of the training design, the training and the screening.
        val_mae: of the surrogate on the validation set. [output's unit]
        test_mae: on the test set. [output's unit]
        test_p90: 90th percentile on the test set. [output's unit]
        training_s: duration of the training. [s]
        mse_surrogate: at the screened point, by the surrogate.
        mse_screened: there, by the FMU.
        n_checks: calls that compared the screened points.
        polish_calls: calls after the training set so far, checks included, rising.
        polish_mse: lowest MSE after them.
        n_polish: calls of the polish.
        mse_polished: at its end.
        stop_reason: why it ended.
        squared_calls: calls of the polish as the paper writes it.
        squared_mse: MSE at its end.
        theta: the calibrated parameters. [per parameter]
    """

    seed: int
    val_mae: float
    test_mae: float
    test_p90: float
    training_s: float
    mse_surrogate: float | None
    mse_screened: float | None
    n_checks: int
    polish_calls: tuple[int, ...]
    polish_mse: tuple[float, ...]
    n_polish: int
    mse_polished: float | None
    stop_reason: str
    squared_calls: int
    squared_mse: float | None
    theta: dict[str, float]


@dataclass(frozen=True)
class SizeCalibrations:
    """All calibrations of one training-set size.

    Args:
        n_train: training-set size.
        surrogate: form of the surrogate.
        settings: its hyperparameters, tuned for Fig. 6.
        tuned_on_d: first and last day of that. [d]
        screening: settings of the screening.
        max_calls: most calls of a polish.
        references: known MSEs: label, MSE, whether it is a target.
        calibrations: one per seed; the first has the seed of Fig. 6.
    """

    n_train: int
    surrogate: str
    settings: Settings
    tuned_on_d: tuple[float, float]
    screening: dict[str, float]
    max_calls: int
    references: tuple[tuple[str, float, bool], ...]
    calibrations: tuple[SeedCalibration, ...]


def read_calibrations(folder: Path) -> tuple[Origin, tuple[SizeCalibrations, ...]]:
    """Read the calibrations of all sizes of a folder, the smallest size first.

    Raises:
        InputError: there is none, one cannot be read, or they belong to different studies.
    """
    return read_sizes(folder, "calibrations of Table 4", _size)


def _size(content: dict[str, Any]) -> SizeCalibrations:
    calibrations = tuple(
        SeedCalibration(
            **{
                **one,
                "polish_calls": tuple(one["polish_calls"]),
                "polish_mse": tuple(one["polish_mse"]),
            }
        )
        for one in content["calibrations"]
    )
    return SizeCalibrations(
        **{
            **content,
            "tuned_on_d": tuple(content["tuned_on_d"]),
            "references": tuple(map(tuple, content["references"])),
            "calibrations": calibrations,
        }
    )

"""What the data determine of a calibrated point, by the slopes that the search knows when it ends.

No simulation is asked for it. `studies uncertainty` says how far open parameters may go.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from studies.calibration.prior import Prior
from studies.report.wording import count, listed, percent
from studies.uncertainty.identifiability import DETERMINED, judged_slopes
from studies.uncertainty.noise import noise_of

CLEAR_PAIR = 0.9
"""A pair is named that makes up so much of an open direction's squared length."""


def determined_numbers(
    names: tuple[str, ...],
    measurement: Measurement,
    prior: Prior | None,
    *,
    u: FloatArray,
    y: FloatArray,
    slopes: FloatArray | None,
) -> dict[str, Any]:
    """Return which parameters the data leave open near a point; empty where too little is known of slopes.

    Args:
        names: Names of the p free parameters.
        measurement: What they were calibrated with.
        prior: What is known of them beforehand, or None.
        u: The point. Shape (p,). [1]
        y: The simulation there. Shape (t, k). [per output]
        slopes: Of the residuals there, in an orthonormal basis. Shape (m, p). [first output's unit per range]
    """
    # What fits to the last digit shows no noise to judge by.
    if slopes is None or not np.any(measurement.compared(y[None])):
        return {}
    noise = noise_of("correlated", measurement, y, len(names))
    found = judged_slopes(names, u, slopes, noise.raised, prior=prior)
    # Two in two open directions, once with each sign, are both open, and none makes up for the other.
    n_times = Counter((pair.first, pair.second) for pair in found.pairs)
    return {
        "determined_by_data": {
            "spread": dict(zip(names, found.spread.tolist(), strict=True)),
            "open": [name for name in names if name not in found.determined],
            "pairs": [
                one.to_dict()
                for one in found.pairs
                if n_times[one.first, one.second] == 1 and abs(one.strength) >= CLEAR_PAIR
            ],
        }
    }


def open_note(name: str, found: Mapping[str, Any]) -> str:
    """Say that a parameter is open and how far, "" where it is not or nobody knows.

    Args:
        name: The parameter.
        found: A calibration's numbers.
    """
    told = found.get("determined_by_data", {})
    if name not in told.get("open", ()):
        return ""
    return f"not determined: ±{percent(told['spread'][name])} of the range"


def open_in_words(found: Mapping[str, Any]) -> list[str]:
    """Say which parameters the data leave open and which compensate each other, in a line each.

    Args:
        found: A calibration's numbers.
    """
    told = found.get("determined_by_data", {})
    if not told.get("open"):
        return []
    n = count(len(told["spread"]), "parameter")
    lines = [
        f"The data do not determine {len(told['open'])} of {n} (standard deviation at the result of "
        f"{percent(DETERMINED)} of the range or more): {listed(told['open'])}"
    ]
    if told["pairs"]:
        lines.append(f"These compensate each other: {'; '.join(one['in_words'] for one in told['pairs'])}")
    return lines

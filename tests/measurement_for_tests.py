"""Measurements like others, but for fields of their outputs."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from simulation.measurement import Measurement
from simulation.samples import Samples


def with_each(measurement: Measurement, **changes: Any) -> Measurement:
    """Return a measurement with other fields of every output."""
    return replace(measurement, outputs=tuple(replace(one, **changes) for one in measurement.outputs))


def with_samples(measurement: Measurement, samples: Sequence[Samples]) -> Measurement:
    """Return a measurement with other samples, in the order of its outputs."""
    pairs = zip(measurement.outputs, samples, strict=True)
    return replace(measurement, outputs=tuple(replace(one, samples=other) for one, other in pairs))

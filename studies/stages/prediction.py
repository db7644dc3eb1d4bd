"""What a prediction comes to: a calibrated model with other inputs, and the columns of its table."""

from collections.abc import Iterator
from dataclasses import dataclass

from simulation.arrays import FloatArray
from studies.stages.saved import WITH_ARRAYS


@dataclass(frozen=True, eq=False)
class Prediction:
    """A calibrated model with other inputs.

    Attributes:
        calibration: Name of the calibration.
        inputs: Place of the recording that drove it.
        table: Place of the CSV file.
        output_names: Names of the k outputs.
        output_units: Their units.
        level: Probability of the bands; None without an uncertainty of this calibration. [1]
        n_sample: Parameter sets that the bands were made of.
        n_failed: Those whose simulation failed.
        time: Output times. Shape (t,). [s]
        y: Outputs of the calibrated parameters. Shape (t, k). [per output]
        simulated: Band of the simulated outputs. Shape (2, t, k). [per output]
        predictive: Band of a measurement. Shape (2, t, k). [per output]
    """

    __pydantic_config__ = WITH_ARRAYS

    calibration: str
    inputs: str
    table: str
    output_names: tuple[str, ...]
    output_units: tuple[str, ...]
    level: float | None
    n_sample: int
    n_failed: int
    time: FloatArray
    y: FloatArray
    simulated: FloatArray | None = None
    predictive: FloatArray | None = None

    @property
    def news(self) -> str:
        """Where its table lies."""
        return f"the table is {self.table}"

    @property
    def has_failures(self) -> bool:
        """Whether a simulation failed."""
        return self.n_failed > 0

    def columns(self) -> Iterator[tuple[str, FloatArray]]:
        """Give the columns of the table with their names."""
        yield "time_s", self.time
        for k, name in enumerate(self.output_names):
            yield name, self.y[:, k]
            for what, band in (("simulated", self.simulated), ("predictive", self.predictive)):
                if band is not None:
                    yield f"{name} {what} low", band[0, :, k]
                    yield f"{name} {what} high", band[1, :, k]

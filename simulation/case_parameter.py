"""Key [[parameters]] of a case file: what is calibrated, and what is known about it beforehand."""

from typing import Literal

from pydantic import model_validator

from simulation.case_table import Finite, Name, Positive, Table
from simulation.parameters import Belief, Parameter


class PriorTable(Table):
    """Key prior of a parameter: where it is expected (`about`, else its estimate), and how surely.

    Two thirds of the probability lie `within` around it for a linear scale, in the parameter's unit, or a
    factor of `within_factor` around it for a logarithmic one.
    """

    about: Finite | None = None
    within: Positive | None = None
    within_factor: Positive | None = None

    @model_validator(mode="after")
    def _one_width(self) -> "PriorTable":
        if (self.within is None) == (self.within_factor is None):
            raise ValueError(
                "give either within (in the parameter's unit) or within_factor (for a log scale), one of them"
            )
        return self


class ParameterTable(Table):
    """Key [[parameters]]: a parameter to calibrate."""

    name: Name
    estimate: Finite | None = None
    lower: Finite
    upper: Finite
    unit: str = "1"
    scale: Literal["linear", "log"] = "linear"
    description: str = ""
    prior: PriorTable | None = None

    @model_validator(mode="after")
    def _prior_fits(self) -> "ParameterTable":
        if self.prior is None:
            return self
        if self.scale == "log" and self.prior.within_factor is None:
            raise ValueError(
                "prior.within belongs to a linear scale; scale is log, so write within_factor, like 1.5"
            )
        if self.scale == "linear" and self.prior.within is None:
            raise ValueError(
                "prior.within_factor belongs to scale log; scale is linear, so write within, in its unit"
            )
        if self.prior.about is None and self.estimate is None:
            raise ValueError("prior has neither about nor an estimate to lie around; add about = ...")
        return self

    def to_parameter(self) -> Parameter:
        """Return the parameter.

        Raises:
            InputError: If its numbers contradict each other.
        """
        belief = None
        if self.prior is not None:
            centre = self.estimate if self.prior.about is None else self.prior.about
            deviation = self.prior.within if self.prior.within_factor is None else self.prior.within_factor
            assert centre is not None, "checked when the table was read"
            assert deviation is not None, "checked when the table was read"
            belief = Belief(centre, deviation)
        return Parameter(**self.model_dump(exclude={"prior"}), prior=belief)

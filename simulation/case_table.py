"""What all tables of a case file share: no unknown key, no silent conversion, and kinds of values."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from simulation.foreign_text import has_control


def _without_control(name: str) -> str:
    if has_control(name):
        raise ValueError("holds a control character or an end of a line; write it without")
    return name


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Line = Annotated[str, AfterValidator(_without_control)]
Name = Annotated[str, Field(min_length=1), AfterValidator(_without_control)]
# TOML arrays arrive as lists; strict mode would take no list for a tuple.
Pair = Annotated[tuple[Finite, Finite], Field(strict=False)]


class Table(BaseModel):
    """A table of a case file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

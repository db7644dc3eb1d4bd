"""What all tables of a case file share: no unknown key, no silent conversion, and kinds of values."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1)]
# TOML arrays arrive as lists; strict mode would take no list for a tuple.
Pair = Annotated[tuple[Finite, Finite], Field(strict=False)]


class Table(BaseModel):
    """A table of a case file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

"""Types of the fields of a scene file, and what every table of it has in common.

Types are strict: text and truth values are no numbers, whole numbers are.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Ranges = Annotated[list[Range], Field(min_length=2, max_length=2)]
# a TOML array is a list; strict tuples would refuse it
Turn = Annotated[tuple[Literal["x", "y", "z"], float], Field(strict=False)]
Positive = Annotated[float, Field(gt=0)]
# an axis, and an angle [rad] by a formula
FormulaTurn = Annotated[tuple[Literal["x", "y", "z"], str], Field(strict=False)]
PARAMETERS = "a table of numbers that the formulas may name"


class Table(BaseModel):
    """A table of a scene file: no unknown names, no infinite numbers."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False
    )

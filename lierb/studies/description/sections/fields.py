"""Base of all tables, and the types of their fields."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PositiveInt, WithJsonSchema

from lierb.studies.description.study_file import LARGEST

# strict: text is no number; inf and NaN are refused
SECTION = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Section(BaseModel):
    """Table of the file."""

    model_config = SECTION

    def given(self) -> dict[str, Any]:
        """Return the keys that are set, with their values."""
        return self.model_dump(exclude_none=True)


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _as_whole(value: Any) -> Any:
    """Convert a float such as 1e6 to an integer, if a file can hold the integer."""
    if isinstance(value, float) and value.is_integer() and abs(value) <= LARGEST:
        return int(value)
    return value


def _one_or_several(kind: str) -> tuple[Any, Any]:
    """Return validator and schema of a list; a list of one item may be written as the item."""
    one = {"type": kind}
    return BeforeValidator(_as_list), WithJsonSchema(
        {"anyOf": [one, {"type": "array", "items": one}]}
    )


Numbers = float | list[float] | list[list[float]]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Twist = Annotated[list[float], Field(min_length=6, max_length=6)]
Frame = list[list[float]]
Whole = BeforeValidator(_as_whole)
Count = Annotated[PositiveInt, Whole]
Names = Annotated[list[str], *_one_or_several("string")]
Several = Annotated[list[float], *_one_or_several("number")]

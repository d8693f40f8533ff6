"""Basis of the tables of a machine file: strict, frozen models, numbers, and file names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat


class Section(BaseModel):
    """A table of the machine file."""

    # Only whole machines are validated, so a section builds no validation of its own on import.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)


def _path(value: Any) -> Any:
    """Return a TOML string as a path, because TOML has no paths."""
    return Path(value) if isinstance(value, str) and value else value


FilePath = Annotated[Path, BeforeValidator(_path)]

Positive = Annotated[FiniteFloat, Field(gt=0)]
MotionLimit = Annotated[FiniteFloat, Field(ge=1e-4)]
"""A limit of speed, acceleration or jerk. With far lower ones a move takes years, and times and
lengths lose their digits.
"""
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


def as_tuple(value: Any) -> Any:
    """Return a TOML array as a tuple, because the frozen models hold tuples."""
    return tuple(value) if isinstance(value, list) else value


def _ascending(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError("must be [lowest, highest]")
    return ends


Span = Annotated[
    tuple[FiniteFloat, FiniteFloat], BeforeValidator(as_tuple), AfterValidator(_ascending)
]
"""Lowest and highest coordinate."""


class Inconsistency(NamedTuple):
    """A contradiction between keys of a machine file.

    Attributes:
        key: Full path of the key that the message is about.
        message: The problem.
        hint: The remedy.
    """

    key: tuple[str, ...]
    message: str
    hint: str

"""Basis of the tables of a machine file: strict, frozen models, and file names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict


class Section(BaseModel):
    """A table of the machine file."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def _path(value: Any) -> Any:
    """Return a TOML string as a path, because TOML has no paths."""
    return Path(value) if isinstance(value, str) and value else value


FilePath = Annotated[Path, BeforeValidator(_path)]

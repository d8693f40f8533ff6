"""The table [program.codes]: the effect of M-codes that a machine builder has added."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from cnc.model.section import FilePath, Section

HIGHEST = 9999
"""Highest number of an M-code."""
_ACTIONS = '"ignore", "pass-on", "pause", { file = "m31.ngc" } or { output = 3, on = true }'
_CODE = re.compile(r"M0*([0-9]{1,4})", re.IGNORECASE)


class RunFile(Section):
    """A file of lines that are executed in place of the code."""

    file: FilePath = Field(description="The file, relative to the machine file.")


class SetOutput(Section):
    """A digital output that the code switches at once."""

    output: Annotated[int, Field(ge=0, le=63)] = Field(description="Number of the output.")
    on: bool = Field(description="Whether the code switches it on.")


CodeAction = Literal["ignore", "pass-on", "pause"] | RunFile | SetOutput
"""``ignore``: no effect. ``pass-on``: the board gets the code. ``pause``: stop for the operator."""


def _codes(value: Any) -> Any:
    """Return a table of codes by their numbers: ``M31`` and ``M031`` are 31."""
    if not isinstance(value, Mapping):
        return value
    actions: dict[int, Any] = {}
    for name, action in value.items():
        if isinstance(name, int):
            number = name
        else:
            code = _CODE.fullmatch(str(name))
            if code is None:
                raise ValueError(f"{name} is not an M-code such as M31")
            number = int(code[1])
        if number in actions:
            raise ValueError(f"M{number} is given twice")
        if not _is_action(action):
            raise ValueError(f"M{number} must be {_ACTIONS}")
        if number in (0, 1, 2, 30, 98, 99):
            raise ValueError(f"M{number} stops or calls a program and keeps its meaning")
        actions[number] = action
    return actions


def _is_action(value: Any) -> bool:
    """Return whether a value of the file describes an effect."""
    if isinstance(value, Mapping):
        output, on = value.get("output"), value.get("on")
        if value.keys() == {"file"}:
            return isinstance(value["file"], str) and bool(value["file"])
        is_number = isinstance(output, int) and not isinstance(output, bool) and 0 <= output <= 63
        return value.keys() == {"output", "on"} and is_number and isinstance(on, bool)
    return isinstance(value, RunFile | SetOutput) or value in ("ignore", "pass-on", "pause")


Codes = Annotated[dict[int, CodeAction], BeforeValidator(_codes)]
"""Effects of M-codes by number."""


def with_absolute_files(codes: Mapping[int, CodeAction], folder: Path) -> dict[int, CodeAction]:
    """Return the table with file names relative to ``folder`` made absolute."""
    return {
        number: action.model_copy(update={"file": folder / action.file})
        if isinstance(action, RunFile)
        else action
        for number, action in codes.items()
    }

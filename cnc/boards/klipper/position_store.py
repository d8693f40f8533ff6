"""Position of the machine on a Klipper board, kept on disk between runs.

A board counts its steps from its configuration on, and no position can be sent to it. So the grid
point at count 0 of each motor is kept here. The board stores a random number with its
configuration. It forgets the number with its counts, when it is reset or configured by another
program.

    STATE/BOARD.klipper.json: `layout`, `number`, `offset` [...], `known` [...], `moving`

`moving` is true while a program runs. If it is still true later, that program was killed, and the
motors stopped without a ramp.
"""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

from pydantic import BaseModel, ConfigDict, Field

from cnc.model.diagnostics import Diagnostic
from cnc.model.state_file import read_state
from cnc.model.state_folder import folder

Unsigned = Annotated[int, Field(ge=0, lt=1 << 32)]
GridPoint = Annotated[int, Field(gt=-(1 << 53), lt=1 << 53)]


class StoredPosition(BaseModel):
    """Content of the file.

    Attributes:
        layout: Checksum of the configuration.
        number: Number that the board stores with it.
        offset: Grid point at count 0 of each motor.
        known: Whether the position of each axis is known.
        moving: Whether a program runs.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)

    layout: Unsigned
    number: Unsigned
    offset: list[GridPoint]
    known: list[bool]
    moving: bool


class PositionStore:
    """The file of one board; without an identity nothing is kept.

    Args:
        board: Identity of the board, "" for none.
    """

    def __init__(self, board: str = "") -> None:
        self._file: Path | None = None
        if board:
            self._file = folder() / f"{quote(board, safe='')}.klipper.json"

    def read(self) -> tuple[StoredPosition | None, list[Diagnostic]]:
        """Return the content, None if there is none that can be used, and warnings."""
        if self._file is None:
            return None, []
        return read_state(self._file, StoredPosition, "home the machine: its position is not known")

    def write(self, content: StoredPosition) -> None:
        """Replace the file. A failure does not stop the machine."""
        if self._file is None:
            return
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            new = self._file.with_suffix(".new")
            with new.open("w", encoding="utf-8") as file:
                file.write(content.model_dump_json())
                file.flush()
                os.fsync(file.fileno())
            new.replace(self._file)

    def number(self, layout: int) -> int:
        """Return a number for a new configuration; without a file always the same."""
        return layout if self._file is None else secrets.randbits(32) or 1

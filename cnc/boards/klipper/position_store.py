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
import json
import os
import secrets
from dataclasses import asdict, dataclass, field
from pathlib import Path
from urllib.parse import quote

from cnc.model.state_folder import folder


@dataclass(frozen=True, slots=True)
class StoredPosition:
    """Content of the file.

    Attributes:
        layout: Checksum of the configuration.
        number: Number that the board stores with it.
        offset: Grid point at count 0 of each motor.
        known: Whether the position of each axis is known.
        moving: Whether a program runs.
    """

    layout: int
    number: int
    offset: list[int] = field(default_factory=list)
    known: list[bool] = field(default_factory=list)
    moving: bool = False


class PositionStore:
    """The file of one board; without an identity nothing is kept.

    Args:
        board: Identity of the board, "" for none.
    """

    def __init__(self, board: str = "") -> None:
        self._file: Path | None = None
        if board:
            self._file = folder() / f"{quote(board, safe='')}.klipper.json"

    def read(self) -> StoredPosition | None:
        """Return the content, None if there is none or it is not readable."""
        if self._file is None:
            return None
        try:
            found = StoredPosition(**json.loads(self._file.read_text(encoding="utf-8")))
            numbers = [int(each) for each in (found.layout, found.number, *found.offset)]
        except (OSError, ValueError, TypeError):
            return None
        return found if numbers else None

    def write(self, content: StoredPosition) -> None:
        """Replace the file. A failure does not stop the machine."""
        if self._file is None:
            return
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            new = self._file.with_suffix(".new")
            with new.open("w", encoding="utf-8") as file:
                json.dump(asdict(content), file)
                file.flush()
                os.fsync(file.fileno())
            new.replace(self._file)

    def number(self, layout: int) -> int:
        """Return a number for a new configuration; without a file always the same."""
        return layout if self._file is None else secrets.randbits(32) or 1

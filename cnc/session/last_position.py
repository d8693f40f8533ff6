"""Machine position at the end of the last run on a board, kept on disk between the runs.

A GRBL board counts its steps from its position at power-up, and its reports do not show a restart.
Therefore the reported position is compared with the position at the end of the last run.

    STATE/positions/BOARD.json: `board`, `position` {axis: mm}, `ended`, `lost`, `shift`,
                                `lost_shift`

STATE is ``XDG_STATE_HOME/cnc`` (``~/.local/state/cnc``), on Windows ``LOCALAPPDATA/cnc``. `ended`
is "" during a run, and after a crash of the computer. Then it is "end", "stopped", or the code of a
fault. `lost`: whether the position is unreliable. `shift` {axis: mm} is the G92 of the board, which
each reset clears. It is `lost_shift` after a restart, until the operator is told.

A record that is there and cannot be read is not an absent one: the position is lost.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import asdict, field
from pathlib import Path
from urllib.parse import quote

from pydantic import FiniteFloat, TypeAdapter
from pydantic.dataclasses import dataclass

from cnc.model.state_folder import folder
from cnc.session.checkpoint import replace_json


@dataclass(frozen=True, slots=True)
class LastPosition:
    """Content of the file. ``position`` is in machine coordinates, mm (degrees), by axis."""

    board: str
    position: Mapping[str, FiniteFloat]
    ended: str = ""
    lost: bool = False
    shift: Mapping[str, FiniteFloat] = field(default_factory=dict)
    lost_shift: Mapping[str, FiniteFloat] = field(default_factory=dict)

    @classmethod
    def read(cls, board: str) -> LastPosition | None:
        """Return the last position of a board by its identity; None if there is none.

        A record that cannot be read is returned as a lost position without axes.
        """
        unreadable = cls(board, {}, lost=True)
        try:
            known = _RECORD.validate_json(_file(board).read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError):
            return unreadable
        return known if known.position and known.board == board else unreadable

    @property
    def file(self) -> Path | None:
        """The record that cannot be read; None where the position is known."""
        return None if self.position else _file(self.board)

    def write(self) -> None:
        """Replace the file of this board. A failure does not stop the machine."""
        file = _file(self.board)
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
        replace_json(file, asdict(self), lasting=True)


_RECORD = TypeAdapter(LastPosition)


def _file(board: str) -> Path:
    return folder() / f"{quote(board, safe='')}.json"

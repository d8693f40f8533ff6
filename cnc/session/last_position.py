"""Machine position at the end of the last run on a board, kept on disk between the runs.

A GRBL board counts its steps from its position at power-up, and its reports do not show a restart.
Therefore the reported position is compared with the position at the end of the last run.

    STATE/positions/BOARD.json: `board`, `position` {axis: mm}, `ended`, `lost`

STATE is ``XDG_STATE_HOME/cnc`` (``~/.local/state/cnc``), on Windows ``LOCALAPPDATA/cnc``. `ended`
is "" during a run, and after a crash of the computer. Then it is "end", "stopped", or the code of a
fault. `lost`: whether the position is unreliable.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import quote

from cnc.model.state_folder import folder
from cnc.session.checkpoint import replace_json


@dataclass(frozen=True, slots=True)
class LastPosition:
    """Content of the file. ``position`` is in machine coordinates, mm (degrees), by axis."""

    board: str
    position: Mapping[str, float]
    ended: str = ""
    lost: bool = False

    @classmethod
    def read(cls, board: str) -> LastPosition | None:
        """Return the last position of a board by its identity; None if none can be read."""
        try:
            known = cls(**json.loads(_file(board).read_text(encoding="utf-8")))
            numbers = [float(value) for value in known.position.values()]
        except (OSError, ValueError, TypeError, AttributeError):
            return None
        return known if numbers else None

    def write(self) -> None:
        """Replace the file of this board. A failure does not stop the machine."""
        file = _file(self.board)
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
        replace_json(file, asdict(self), lasting=True)


def _file(board: str) -> Path:
    return folder() / f"{quote(board, safe='')}.json"

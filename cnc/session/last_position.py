"""The machine position at which the last run on a board ended, kept on disk from one run to the
next.

A GRBL board counts its steps from wherever it was when it started, and says nothing of a restart in
its reports. So what it reports is compared with where the last run left it.

    STATE/positions/BOARD.json: `board`, `position` {axis: mm}, `ended`, `lost`

STATE is ``XDG_STATE_HOME/cnc`` (``~/.local/state/cnc``), on Windows ``LOCALAPPDATA/cnc``. `ended`
is "" while a run is under way (or its computer has died), then "end", "stopped", or the code of a
fault. `lost`: whether the position can't be relied on.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import quote

from cnc.session.checkpoint import write_whole


def folder() -> Path:
    """Where this user's positions are kept."""
    if named := os.environ.get("XDG_STATE_HOME"):
        return Path(named) / "cnc" / "positions"
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local) / "cnc" / "positions"
    return Path(os.path.expanduser("~")) / ".local" / "state" / "cnc" / "positions"


@dataclass(frozen=True, slots=True)
class LastPosition:
    """What is written; see above. position: machine coordinates, mm (degrees) by axis letter."""

    board: str
    position: Mapping[str, float]
    ended: str = ""
    lost: bool = False

    @classmethod
    def read(cls, board: str) -> LastPosition | None:
        """That of a board by its identity; None if there is none, or none that can be
        understood.
        """
        try:
            known = cls(**json.loads(_file(board).read_text(encoding="utf-8")))
            numbers = [float(value) for value in known.position.values()]
        except (OSError, ValueError, TypeError, AttributeError):
            return None
        return known if numbers else None

    def write(self) -> None:
        """Replace what was kept of this board. A folder that can't be written to is no reason to
        stop a machine.
        """
        file = _file(self.board)
        with contextlib.suppress(OSError):
            file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, asdict(self), lasting=True)


def _file(board: str) -> Path:
    return folder() / f"{quote(board, safe='')}.json"

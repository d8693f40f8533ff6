"""Folder of the files that are kept between runs, such as the positions of machines.

It is ``XDG_STATE_HOME/cnc/positions`` (``~/.local/state/cnc/positions``), on Windows
``LOCALAPPDATA/cnc/positions``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path


def folder() -> Path:
    """Return the folder of the files, for the present user."""
    if named := os.environ.get("XDG_STATE_HOME"):
        return Path(named) / "cnc" / "positions"
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local) / "cnc" / "positions"
    return Path(os.path.expanduser("~")) / ".local" / "state" / "cnc" / "positions"

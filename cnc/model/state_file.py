"""Files that are kept between runs, and their folder; a damaged file is set aside."""

from __future__ import annotations

import contextlib
import os
import stat
import sys
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from cnc.model.diagnostics import Diagnostic

LARGEST = 1 << 20
"""Bytes. Larger files are not read: the largest that is written has some kilobytes."""
DAMAGED = ".damaged"
"""Ends the name of a file that was set aside."""
Content = TypeVar("Content", bound=BaseModel)


def read_state(
    file: Path, model: type[Content], remedy: str
) -> tuple[Content | None, list[Diagnostic]]:
    """Return the content of a file that an earlier run has written.

    Args:
        file: The file.
        model: Its content.
        remedy: What to do if it is damaged.

    Returns:
        The content, None if there is no file or it is damaged; a warning if it is damaged.
    """
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode):
            reason = "it is no regular file"
        elif status.st_size > LARGEST:
            reason = f"it is larger than {LARGEST} bytes"
        else:
            return model.model_validate_json(file.read_bytes()), []
    except (FileNotFoundError, NotADirectoryError):
        return None, []
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"])[:80]
        reason = f"{place + ': ' if place else ''}{first['msg']}"
    except OSError as error:
        reason = error.strerror or str(error)
    message = f"a file of an earlier run is damaged and was not used: {reason}"
    aside = file.with_name(file.name + DAMAGED)
    with contextlib.suppress(OSError):
        file.replace(aside)
        message += f"; it is now {aside.name}"
    return None, [
        Diagnostic("state-file-damaged", message, str(file), hint=remedy, severity="warning")
    ]


# Folder of the files that are kept between runs, such as the positions of machines.
#
# It is ``XDG_STATE_HOME/cnc/positions`` (``~/.local/state/cnc/positions``), on Windows
# ``LOCALAPPDATA/cnc/positions``.


def folder() -> Path:
    """Return the folder of the files, for the present user."""
    if named := os.environ.get("XDG_STATE_HOME"):
        return Path(named) / "cnc" / "positions"
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local) / "cnc" / "positions"
    return Path(os.path.expanduser("~")) / ".local" / "state" / "cnc" / "positions"

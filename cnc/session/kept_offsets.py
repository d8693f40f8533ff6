"""Offsets (G54 to G59, G28, G30) of a GRBL board, kept on disk for checks without the board.

They are those of the end of the last run, or of ``cncrun boards``. G92 is not among them, because a
reset of the board clears it.

    STATE/positions/BOARD.offsets.json: {name: {axis: mm}}, see :mod:`cnc.session.last_position`
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from pydantic import ConfigDict, FiniteFloat, RootModel

from cnc.model.blocks import AxisLetter
from cnc.model.diagnostics import Diagnostic
from cnc.model.state_file import read_state
from cnc.model.state_folder import folder
from cnc.session.checkpoint import replace_json

KEPT = ("G54", "G55", "G56", "G57", "G58", "G59", "G28", "G30")
Offsets = dict[str, dict[str, float]]
"""Offset of each axis, mm, by name."""


class _Content(RootModel[dict[str, dict[AxisLetter, FiniteFloat]]]):
    """Content of the file."""

    model_config = ConfigDict(defer_build=True, strict=True)


def read_offsets(board: str) -> tuple[Offsets | None, list[Diagnostic]]:
    """Return the offsets of a board by its identity, None if none can be read, and warnings."""
    hint = "cncrun boards reads the offsets of the board, and keeps them for later checks"
    found, warnings = read_state(_file(board), _Content, hint)
    if found is None:
        return None, warnings
    kept = {name: place for name, place in found.root.items() if name in KEPT}
    return {
        name: {str(axis): value for axis, value in place.items()} for name, place in kept.items()
    }, []


def write_offsets(board: str, offsets: Mapping[str, Mapping[str, float]]) -> None:
    """Replace the file of a board. A failure does not stop the machine."""
    file = _file(board)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
    content = {name: dict(place) for name, place in offsets.items() if name in KEPT}
    replace_json(file, content, lasting=False)


def _file(board: str) -> Path:
    return folder() / f"{quote(board, safe='')}.offsets.json"

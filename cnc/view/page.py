"""The picture as one HTML page that needs nothing else: no network, no other file.

What comes from the program (its text, its name, its comments in findings) is deflated and written
in base 64, the letters of which can't end an element or begin one; the page's script turns it into
text nodes and numbers. The page's policy lets no script run but that one, by its hash, and nothing
be fetched from anywhere.
"""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Iterable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cnc.model.diagnostics import SHOWN_CHARACTERS, Diagnostic, UsageError
from cnc.outputs.targets import TextTarget
from cnc.report.result import Report
from cnc.report.summary import clock, number
from cnc.view.collect import DRAWN_AXES, Picture, Sizes, stock_box, travel_box
from cnc.view.tables import FINEST, tolerance_shown

SIZES = Sizes(strokes=1 << 19, curves=1 << 17, origins=1 << 20)
"""What a page holds of a motion: some 20 MB, which browsers open in seconds and turn without a
hitch.
"""
QUANTUM = FINEST / 4
"""mm: positions are whole multiples of it, unless the path is too long for 32 bits."""
TEXT_MOST = 1 << 28
"""Bytes of a program that the page shows; what is behind them is not in it, and it says so."""
LEVELS = 32767
"""Steps of a colour scale."""
SCRIPTS = ("data.js", "levels.js", "scene.js", "graph.js", "source.js", "page.js", "pointer.js")
PIECE = 3 << 18
"""Bytes that are read and written at a time, a multiple of three."""


def write_page(
    target: TextTarget, picture: Picture, report: Report, texts: Iterable[tuple[str, Path]]
) -> None:
    """The page; ``texts`` are the programs by name, in the order of ``picture.files``."""
    style, script = _asset("page.css"), "".join(_asset(name) for name in SCRIPTS)
    policy = f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; base-uri 'none'; form-action 'none'; img-src 'none'"
    page = _asset("page.html").replace("{{policy}}", policy).replace("{{style}}", style)
    before, _, after = page.partition("<!--data-->\n")
    target.write(before)
    about = _about(picture, report)
    for name, column in _columns(picture, about):
        _element(target, f"column-{name}", [column.tobytes()])
    notes = []
    for index, (name, path) in enumerate(texts):
        try:
            if path.stat().st_size > TEXT_MOST:
                notes.append(f"only the first {TEXT_MOST >> 20} MB of {name} are shown")
            _element(target, f"text-{index}", _pieces(path))
        except OSError as error:
            raise UsageError(
                Diagnostic("unreadable-file", f"can't read {name}: {error.strerror}", file=name)
            ) from None
    about["note"] = ", ".join(notes)
    _element(target, "about", [json.dumps(about, allow_nan=False).encode()])
    target.write(after.replace("{{script}}", script))


def _asset(name: str) -> str:
    return (resources.files(__package__) / "page" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """As a policy names an element by its content (CSP level 3, section 2.3.1)."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _element(target: TextTarget, name: str, pieces: Iterable[bytes]) -> None:
    """An element of data that no browser looks into."""
    target.write(f'<script type="application/octet-stream" id="{name}">')
    packer, rest = zlib.compressobj(6), b""
    for piece in pieces:
        rest += packer.compress(piece)
        whole = len(rest) // 3 * 3
        target.write(base64.b64encode(rest[:whole]).decode())
        rest = rest[whole:]
    target.write(base64.b64encode(rest + packer.flush()).decode())
    target.write("</script>\n")


def _pieces(path: Path) -> Iterator[bytes]:
    left = TEXT_MOST
    with path.open("rb") as file:
        while left and (piece := file.read(min(PIECE, left))):
            left -= len(piece)
            yield piece


def _about(picture: Picture, report: Report) -> dict[str, Any]:
    """What the page's script has to know besides the columns; lengths in mm, times in s."""
    strokes, limits = picture.strokes, report.limits
    low, high = strokes.position.min(axis=0), strokes.position.max(axis=0)
    return {
        "program": report.program,
        "facts": f"{clock(picture.duration)} · {number(report.path_length_mm)} mm · {number(report.lines)} lines · {report.machine.name}",
        "accuracy": _accuracy(picture),
        "duration": picture.duration,
        "tick": max(picture.duration, 1e-9) / (2**32 - 1),
        "quantum": max(QUANTUM, float((high - low).max()) / 2**31),
        "units": {name: _step(getattr(strokes, name)) for name in ("feed", "accel", "jerk")},
        "middle": (0.5 * (low + high)).tolist(),
        "extent": np.stack((low, high), axis=1).tolist(),
        "travel": travel_box(report.machine),
        "stock": stock_box(report.machine),
        "limits": [limits.feed, limits.accel, limits.jerk],
        "tolerance": strokes.tolerance,
        "exact": picture.curves.within == 0.0,
        "files": picture.files,
        "findings": [
            [
                picture.files.index(each.file),
                each.line,
                f"{each.severity}: {each.code}: {each.message}"[: 4 * SHOWN_CHARACTERS],
            ]
            for each in report.findings
            if each.file in picture.files and each.line
        ],
    }


def _accuracy(picture: Picture) -> str:
    """How near the page is to the plan."""
    strokes, curves = picture.strokes, picture.curves
    parts = [
        f"At every moment the tool is drawn within {tolerance_shown(strokes.tolerance)} mm of the plan ({max(len(strokes.t) - 1, 0):,} "
        "strokes), and on the screen within half a pixel of that; coarser while it turns, where that would take too long."
    ]
    if curves.within:
        parts.append(
            f"The curves show the least and the greatest values within {tolerance_shown(1e3 * curves.within)} ms."
        )
    else:
        parts.append("The curves are those of the plan, phase by phase.")
    if picture.moves > 1:
        parts.append(f"Up to {picture.moves} moves share an entry of source lines.")
    return " ".join(parts)


def _columns(picture: Picture, about: dict[str, Any]) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Each array as bytes, in the forms that ``data.js`` reads."""
    strokes, curves, origins, tick = picture.strokes, picture.curves, picture.origins, about["tick"]
    yield "t", _integers(np.rint(strokes.t / tick))
    for axis, values, middle in zip(DRAWN_AXES, strokes.position.T, about["middle"], strict=True):
        yield axis, _integers(np.rint((values - middle) / about["quantum"]))
    for name in ("feed", "accel", "jerk"):
        yield name, _integers(np.rint(getattr(strokes, name) / about["units"][name]))
    yield "rapid", _integers(strokes.rapid)
    yield "curve-t", _integers(np.rint(curves.t / tick))
    for row, name in enumerate(("feed", "accel", "jerk")):
        if curves.within == 0.0:
            yield f"start-{name}", _floats(curves.start[row])
        else:
            yield f"low-{name}", _floats(curves.low[row])
            yield f"high-{name}", _floats(curves.high[row])
    yield "origin-t", _integers(np.rint(origins.t / tick))
    yield "origin-first", _integers(origins.first)
    # As a rule there is nothing but zeros in these.
    for name, values in (
        ("origin-more", origins.last - origins.first),
        ("origin-file", origins.file),
    ):
        if values.any():
            yield name, _integers(values)


def _step(values: NDArray[np.float64]) -> float:
    """The smallest difference that is kept of such values."""
    return (float(np.abs(values).max(initial=0.0)) or 1.0) / LEVELS


def _integers(values: ArrayLike) -> NDArray[np.uint8]:
    """Whole numbers of 32 bits: differences, zigzag (the sign last), the lowest bytes of all first.
    They are small, so they pack well.
    """
    whole = np.asarray(values).astype(np.int64)
    steps = np.diff(whole, prepend=0).astype(np.uint32).view(np.int32)
    zigzag = ((steps << 1) ^ (steps >> 31)).view(np.uint32)
    return np.ascontiguousarray(zigzag.astype("<u4").view(np.uint8).reshape(-1, 4).T)


def _floats(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Floats of 32 bits, the lowest bytes of all first."""
    return np.ascontiguousarray(
        np.ascontiguousarray(values, dtype="<f4").view(np.uint8).reshape(-1, 4).T
    )

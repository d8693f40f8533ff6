"""The picture as one HTML page that needs no network and no other file.

Everything that comes from the program (its text, its name, findings) is deflated and written in
base 64. Its letters cannot end or begin an element, and the script of the page turns it into text
nodes and numbers only. The content security policy of the page permits this script alone, by its
hash, and forbids all network access.
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

from cnc.machine.models import Machine
from cnc.model.diagnostics import SHOWN_CHARACTERS, Diagnostic, UsageError, shown_name
from cnc.planner.joints import Joints
from cnc.report.result import Report, clock, number
from cnc.report.targets import TextTarget
from cnc.view.collect import DRAWN_AXES, QUANTITIES, Picture, Sizes, stock_box, travel_box
from cnc.view.tables import FINEST, tolerance_shown

SIZES = Sizes(strokes=1 << 19, curves=1 << 17, origins=1 << 20, joints=1 << 12)
"""Sizes of the tables of a page. A full page has about 20 MB, which browsers open in seconds."""
QUANTUM = FINEST / 4
"""mm. Positions are whole multiples of it, unless the path is too large for 32 bits."""
TEXT_MOST = 1 << 28
"""Bytes of a program that the page contains. The page states if a program is longer."""
LEVELS = 32767
"""Number of steps of feed, acceleration and jerk."""
SCRIPTS = ("data.js", "levels.js", "scene.js", "graph.js", "source.js", "page.js", "pointer.js")
PIECE = 3 << 18
"""Bytes that are read and written at a time; base 64 needs a multiple of three."""


def write_page(
    target: TextTarget, picture: Picture, report: Report, texts: Iterable[tuple[str, Path]]
) -> None:
    """Write the page.

    Args:
        target: receives the page.
        picture: the data to draw.
        report: the result for the program.
        texts: name and file of each program, in the order of ``picture.files``.

    Raises:
        UsageError: ``unreadable-file`` for a file of ``texts``.
    """
    style, script = _asset("page.css"), "".join(_asset(name) for name in SCRIPTS)
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; "
        "base-uri 'none'; form-action 'none'; img-src 'none'"
    )
    page = _asset("page.html").replace("{{policy}}", policy).replace("{{style}}", style)
    before, _, after = page.partition("<!--data-->\n")
    target.write(before)
    about = about_picture(picture, report)
    for name, column in packed_columns(picture, about):
        _element(target, f"column-{name}", [column.tobytes()])
    notes = []
    for index, (name, path) in enumerate(texts):
        try:
            if path.stat().st_size > TEXT_MOST:
                notes.append(f"only the first {TEXT_MOST >> 20} MB of {name} are shown")
            _element(target, f"text-{index}", _pieces(path))
        except OSError as error:
            raise UsageError(
                Diagnostic("unreadable-file", f"{name} cannot be read: {error.strerror}", file=name)
            ) from None
    about["note"] = ", ".join(notes)
    _element(target, "about", [json.dumps(about, allow_nan=False).encode()])
    target.write(after.replace("{{script}}", script))


def write_data(target: TextTarget, picture: Picture, report: Report) -> None:
    """Write the data of the page alone, as JSON: ``about`` and ``columns`` in base 64."""
    about = about_picture(picture, report)
    about["note"] = ""
    columns = {
        name: base64.b64encode(zlib.compress(column.tobytes(), 6)).decode()
        for name, column in packed_columns(picture, about)
    }
    target.write(json.dumps({"about": about, "columns": columns}, allow_nan=False))


def _asset(name: str) -> str:
    return (resources.files(__package__) / "page" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Return the hash of an element for the policy (CSP level 3, section 2.3.1)."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _element(target: TextTarget, name: str, pieces: Iterable[bytes]) -> None:
    """Write an element with data that browsers do not interpret."""
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


def about_picture(picture: Picture, report: Report) -> dict[str, Any]:
    """Return the data of the page besides the columns, lengths in mm and times in s."""
    strokes, limits = picture.strokes, report.limits
    low, high = strokes.position.min(axis=0), strokes.position.max(axis=0)
    return {
        "program": shown_name(report.program),
        "facts": _facts(picture, report),
        "accuracy": _accuracy(picture),
        "duration": picture.duration,
        "tick": max(picture.duration, 1e-9) / (2**32 - 1),
        "quantum": max(QUANTUM, float((high - low).max()) / 2**31),
        "units": {name: _step(getattr(strokes, name)) for name in ("feed", "accel", "jerk")},
        "middle": (0.5 * (low + high)).tolist(),
        "extent": np.stack((low, high), axis=1).tolist(),
        "travel": travel_box(report.machine),
        "stock": stock_box(report.machine),
        "lathe": report.machine.kind == "lathe",
        "limits": [limits.feed, limits.accel, limits.jerk],
        "tolerance": strokes.tolerance,
        "exact": picture.curves.within == 0.0,
        "joints": [] if picture.joints is None else _joints(report.machine),
        "files": [shown_name(each) for each in picture.files],
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


def _joints(machine: Machine) -> list[dict[str, Any]]:
    """Return name, unit, and limits of velocity and acceleration of each joint."""
    joints = zip(machine.joint_tables.items(), Joints(machine).angular, strict=True)
    return [
        {
            "name": name.upper(),
            "unit": "\u00b0" if angular else "mm",
            "limits": [joint.max_velocity, joint.max_acceleration],
        }
        for (name, joint), angular in joints
    ]


def _facts(picture: Picture, report: Report) -> str:
    parts = (
        clock(picture.duration),
        f"{number(report.path_length_mm)} mm",
        f"{number(report.lines)} lines",
        report.machine.name,
    )
    return " · ".join(parts)


def _accuracy(picture: Picture) -> str:
    """Return the accuracy of the page as text."""
    strokes, curves = picture.strokes, picture.curves
    parts = [
        f"At every time the tool is drawn within {tolerance_shown(strokes.tolerance)} mm of the "
        f"plan ({max(len(strokes.t) - 1, 0):,} strokes), and on the screen within half a pixel of "
        "that. While the view rotates, a large path is drawn coarser."
    ]
    if curves.within:
        parts.append(
            "The curves show the least and the greatest values within "
            f"{tolerance_shown(1e3 * curves.within)} ms."
        )
    else:
        parts.append("The curves are exact.")
    if picture.moves > 1:
        parts.append(f"Up to {picture.moves} moves share one range of source lines.")
    return " ".join(parts)


def packed_columns(
    picture: Picture, about: dict[str, Any]
) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yield name and bytes of each array, in the forms that ``data.js`` reads."""
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
    if picture.joints is not None:
        yield "joint-t", _integers(np.rint(np.minimum(picture.joints.t, picture.duration) / tick))
        for joint in range(picture.joints.low.shape[2]):
            for row, name in enumerate(QUANTITIES):
                yield f"joint-{joint}-low-{name}", _floats(picture.joints.low[:, row, joint])
                yield f"joint-{joint}-high-{name}", _floats(picture.joints.high[:, row, joint])
    yield "origin-t", _integers(np.rint(origins.t / tick))
    yield "origin-first", _integers(origins.first)
    # These are usually all zeros.
    for name, values in (
        ("origin-more", origins.last - origins.first),
        ("origin-file", origins.file),
    ):
        if values.any():
            yield name, _integers(values)


def _step(values: NDArray[np.float64]) -> float:
    """Return the step to which values are rounded."""
    return (float(np.abs(values).max(initial=0.0)) or 1.0) / LEVELS


def _integers(values: ArrayLike) -> NDArray[np.uint8]:
    """Return whole numbers of 32 bits as bytes, in a form that compresses well.

    The form has differences, zigzag encoding (the sign in the lowest bit), and the lowest bytes of
    all numbers first.
    """
    whole = np.asarray(values).astype(np.int64)
    steps = np.diff(whole, prepend=0).astype(np.uint32).view(np.int32)
    zigzag = ((steps << 1) ^ (steps >> 31)).view(np.uint32)
    return np.ascontiguousarray(zigzag.astype("<u4").view(np.uint8).reshape(-1, 4).T)


def _floats(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return floats of 32 bits as bytes, the lowest bytes of all numbers first."""
    return np.ascontiguousarray(
        np.ascontiguousarray(values, dtype="<f4").view(np.uint8).reshape(-1, 4).T
    )

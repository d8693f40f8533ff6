"""Modal state, position and time at lines of a program: for hovers and inlay hints.

The program is read up to the lines that are asked for. Lines before them are executed in bulk.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.editor.analysis import Settings, session_of
from cnc.editor.document import Document
from cnc.gcode.core.line_trace import ExecutedLines, LineTrace, Offsets
from cnc.gcode.core.modal_groups import ModalState
from cnc.gcode.reader.source_text import Window
from cnc.machine.models import Machine
from cnc.model.blocks import (
    PLANE_AXES,
    ArcFeed,
    Block,
    Dwell,
    NurbsFeed,
    Polyline,
    Probe,
    TipControl,
)
from cnc.model.diagnostics import CncError
from cnc.model.units import per_minute
from cnc.report.result import clock, position

Floats = NDArray[np.float64]

SAMPLES = 64
"""Points of a NURBS for its length."""


@dataclass(frozen=True)
class LineState:
    """A line that was executed, the first time.

    Attributes:
        line: Its number.
        modal: The modal state behind it.
        offsets: The offsets behind it.
        begin: Position before it, machine coordinates (axes,) mm.
        end: Position behind it, machine coordinates (axes,) mm.
        length: Length of its moves in X, Y and Z, mm.
        seconds: Their time at the programmed feed, traverses at the speed of the axes, with dwells.
        feed: Feed of its last feed move, mm/s; NaN for a traverse, None without a move.
    """

    line: int
    modal: ModalState
    offsets: Offsets
    begin: tuple[float, ...]
    end: tuple[float, ...]
    length: float
    seconds: float
    feed: float | None

    def in_program(self) -> tuple[float, ...] | None:
        """Return the end in program coordinates, mm; None where they are turned or scaled."""
        offsets = self.offsets
        if offsets.turned:
            return None
        parts = (offsets.origin, offsets.external, offsets.tool, offsets.shift, offsets.local)
        return tuple(value - sum(terms) for value, *terms in zip(self.end, *parts, strict=True))


class _Moves:
    """Position, length and time of the blocks of a line."""

    def __init__(self, machine: Machine, start: Floats) -> None:
        self.position = np.array(start, np.float64)
        self._names = machine.axis_names
        self._linear = [self._names.index(axis) for axis in "xyz" if axis in self._names]
        self._speeds = np.array([axis.max_velocity for axis in machine.axes.values()])
        self.length = self.seconds = 0.0
        self.feed: float | None = None

    def begin(self) -> None:
        self.length = self.seconds = 0.0
        self.feed = None

    def add(self, block: Block) -> None:
        if isinstance(block, Polyline):
            steps = np.diff(np.vstack((self.position[None], block.points)), axis=0)
            self._add(np.linalg.norm(steps[:, self._linear], axis=1), block.feeds, steps)
            self.position = np.array(block.points[-1])
        elif isinstance(block, ArcFeed):
            first, second = PLANE_AXES[block.plane]
            step = block.end - self.position
            off = [at for at in self._linear if self._names[at] not in (first, second)]
            round_ = 2.0 * math.pi * abs(block.turns) * block.radius
            self._move(math.hypot(round_, *step[off].tolist()), block.feed, step)
            self.position = np.array(block.end)
        elif isinstance(block, NurbsFeed):
            points = _points(block)
            steps = np.diff(points[:, self._linear], axis=0)
            step = block.control_points[-1] - self.position
            self._move(float(np.linalg.norm(steps, axis=1).sum()), block.feed, step)
            self.position = np.array(block.control_points[-1])
        elif isinstance(block, Probe):
            step = block.end - self.position
            self._move(float(np.linalg.norm(step[self._linear])), block.feed, step)
            self.position = np.array(block.end)
        elif isinstance(block, TipControl):
            self.position = np.array(block.position)
        elif isinstance(block, Dwell):
            self.seconds += block.seconds

    def _move(self, length: float, feed: float, step: Floats) -> None:
        self._add(np.array([length]), np.array([feed]), step[None])

    def _add(self, lengths: Floats, feeds: Floats, steps: Floats) -> None:
        """Add moves: lengths (n,) mm, feeds (n,) mm/s or NaN, and steps (n, axes) mm."""
        largest = np.abs(steps).max(axis=1)
        traverses = (np.abs(steps) / self._speeds).max(axis=1)
        # A move of rotary axes alone has its feed in degrees.
        fed = np.where(lengths > 0.0, lengths, largest) / np.where(feeds > 0.0, feeds, np.inf)
        self.seconds += float(np.where(np.isnan(feeds), traverses, fed).sum())
        self.length += float(lengths.sum())
        self.feed = float(feeds[-1])


def _points(curve: NurbsFeed) -> Floats:
    """Return points of a NURBS (samples, axes) by de Boor's recursion."""
    knots, degree = curve.knots, curve.degree
    weights = curve.weights[:, None]
    homogeneous = np.hstack((curve.control_points * weights, weights))
    out = []
    for u in np.linspace(knots[degree], knots[len(weights)], SAMPLES):
        span = int(np.searchsorted(knots, u, side="right")) - 1
        span = min(max(span, degree), len(weights) - 1)
        d = homogeneous[span - degree : span + 1].copy()
        for r in range(1, degree + 1):
            for j in range(degree, r - 1, -1):
                low, high = knots[j + span - degree], knots[j + 1 + span - r]
                share = 0.0 if high == low else (u - low) / (high - low)
                d[j] = (1.0 - share) * d[j - 1] + share * d[j]
        out.append(d[degree][:-1] / d[degree][-1])
    return np.array(out)


def line_states(
    document: Document,
    settings: Settings,
    first: int,
    last: int,
    is_stopped: Callable[[], bool] = lambda: False,
) -> dict[int, LineState]:
    """Return the states of the lines ``first`` to ``last`` that are executed, by their numbers.

    A line that a loop executes again has the state of the first time. Lines behind an error have
    none.

    Args:
        document: The text.
        settings: What holds for it.
        first: First line.
        last: Last line.
        is_stopped: Asked from time to time; the result is not needed any more.
    """
    session = session_of(document, settings)
    states: dict[int, LineState] = {}
    try:
        reading = session.traced(LineTrace(_bulk(first, last)))
        moves = _Moves(settings.machine, session.start)
        for state in _states(reading, moves, document.name, first, last):
            if state is not None:
                states.setdefault(state.line, state)
            if is_stopped() or len(states) > last - first or (state and state.line == last):
                break
    except CncError:
        pass
    return states


def _bulk(first: int, last: int) -> Callable[[Window, int, int], int]:
    def bulk(window: Window, index: int, end: int) -> int:
        line = window.first + index
        if first <= line <= last:
            return 0
        return end - index if line > last else min(end - index, first - line)

    return bulk


def _states(
    blocks: Iterator[Block], moves: _Moves, name: str, first: int, last: int
) -> Iterator[LineState | None]:
    """Yield the state of each line of the range that is executed, and None for others."""
    begin = tuple(moves.position.tolist())
    for block in blocks:
        if not isinstance(block, ExecutedLines):
            moves.add(block)
            continue
        end = tuple(moves.position.tolist())
        if block.file == name and first <= block.line == block.last <= last:
            yield LineState(
                block.line, block.modal, block.offsets, begin, end, moves.length, moves.seconds,
                moves.feed,
            )  # fmt: skip
        else:
            yield None
        begin = end
        moves.begin()


# The state of a line in words.


def modal_words(modal: ModalState) -> str:
    """Return the codes in effect, as a machinist writes them."""
    planes = {"XY": "G17", "ZX": "G18", "YZ": "G19"}
    modes = {"per-minute": "G94", "inverse-time": "G93", "per-revolution": "G95"}
    words = [
        modal.motion.written if modal.motion is not None else "G80",
        planes[modal.plane],
        "G21" if modal.scale == 1.0 else "G20",
        "G90" if modal.absolute else "G91",
        modes[modal.feed_mode],
        *([modal.compensation.written] if modal.compensation.written != "G40" else []),
    ]
    if modal.feed is not None:
        words.append(f"F{feed_number(modal)}")
    if modal.speed is not None and not modal.constant_surface:
        words.append(f"S{modal.speed:g}")
    words.append({"cw": "M3", "ccw": "M4", "off": "M5"}[modal.spindle])
    words += [word for word, on in (("M7", modal.mist), ("M8", modal.flood)) if on]
    if modal.loaded or modal.tool:
        words.append(f"T{modal.loaded or modal.tool}")
    return " ".join(words)


def feed_number(modal: ModalState) -> str:
    """Return the feed in effect in program units a minute, or a revolution."""
    assert modal.feed is not None
    linear = modal.feed.linear / modal.feed_scale
    return f"{linear if modal.feed_mode == 'per-revolution' else per_minute(linear):.6g}"


def place(values: tuple[float, ...], names: tuple[str, ...], modal: ModalState) -> str:
    """Return a place in program units, such as "X10 Y20"; X is a diameter under G7."""
    words = []
    for name, value in zip(names, values, strict=True):
        unit = 1.0 if name in "abc" else modal.scale
        factor = modal.x_factor(absolute=True) if name == "x" else 1.0
        words.append(f"{name.upper()}{position(value / unit / factor)}")
    return " ".join(words)


def described(state: LineState, names: tuple[str, ...]) -> list[str]:
    """Return the state of a line as lines of text."""
    lines = [f"in effect: {modal_words(state.modal)}"]
    program = state.in_program()
    if program is not None:
        lines.append(f"position behind the line: {place(program, names, state.modal)}")
    machine = " ".join(
        f"{name.upper()}{position(value)}" for name, value in zip(names, state.end, strict=True)
    )
    if program is None or any(abs(a - b) > 1e-9 for a, b in zip(program, state.end, strict=True)):
        lines.append(f"machine coordinates: {machine} mm")
    if state.length or state.seconds:
        lines.append(f"{state.length:.6g} mm, {clock(state.seconds)} at the programmed feed")
    return lines


def hint(state: LineState, names: tuple[str, ...], code: str) -> str:
    """Return the hint behind a line: its end, and the feed if the line does not have it.

    Args:
        state: The state of the line.
        names: Letters of the axes.
        code: The line without comments, in capitals.
    """
    if state.feed is None:
        return ""
    values = state.in_program()
    parts = [place(state.end if values is None else values, names, state.modal)]
    if values is None:
        parts.append("(machine)")
    if state.feed == state.feed and "F" not in code and state.modal.feed is not None:
        parts.append(f"F{feed_number(state.modal)}")
    return " ".join(parts)

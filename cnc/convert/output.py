"""The lines of a result, and the state of the control behind them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cnc.convert.curves import Curve, Spline
from cnc.convert.target import Target, number, without_comments
from cnc.convert.turning import TurningState
from cnc.gcode.core.line_trace import ExecutedLines
from cnc.gcode.core.modal_groups import PLANES
from cnc.gcode.reader.words import G
from cnc.model.blocks import PLANE_AXES, ROTARY_LETTERS, Plane
from cnc.model.diagnostics import Diagnostic, GcodeError

MM_DIGITS, INCH_DIGITS = 5, 6
"""Decimals of positions."""
PITCH_DIGITS = 9
"""Decimals of the lead of a thread."""
PLANE_CODES = {plane: code for code, plane in PLANES.items()}
_CENTER = {"x": "I", "y": "J", "z": "K"}
UNKNOWN: Any = "unknown"
_SAME_LEAD = 1e-6
"""Largest relative difference of a lead from the feed of its first move."""


@dataclass
class ControlState:
    """State of the control behind the lines written so far."""

    motion: Any = UNKNOWN
    plane: Any = UNKNOWN
    scale: Any = UNKNOWN
    absolute: Any = UNKNOWN
    arc_absolute: bool = False
    feed_mode: Any = UNKNOWN
    feed: Any = UNKNOWN
    initial_level: Any = UNKNOWN
    speed: Any = UNKNOWN
    tool: Any = UNKNOWN
    system: Any = UNKNOWN


class Output:
    """Writes lines, and moves as lines of the control.

    Args:
        target: The control.
        axes: Letters of the machine's axes.
        start: Position before the program (axes,), mm.
        file: Receives the lines.

    Attributes:
        line: Number of the next line.
        label: Block number for the next line with code.
        position: Position behind the lines (axes,), mm.
        state: State of the control.
        shift: Its G92 (axes,), mm.
        tool: Its tool offset (axes,), mm.
        turning: Its state that only lathes need.
    """

    def __init__(
        self, target: Target, axes: tuple[str, ...], start: NDArray[np.float64], file: IO[bytes]
    ) -> None:
        self.target, self.axes = target, axes
        self._file = file
        self.line = 1
        self.label = b""
        self.position = start
        self.state = ControlState()
        self.shift: tuple[float, ...] = (0.0,) * len(axes)
        self.tool: tuple[float, ...] = (0.0,) * len(axes)
        self.turning = TurningState()

    def zero(self, mark: ExecutedLines) -> NDArray[np.float64]:
        """Return the machine position of the control's program zero (axes,)."""
        parts = (mark.offsets.origin, self.shift, self.tool)
        return np.array([sum(values) for values in zip(*parts, strict=True)])

    def number(self, axis: str, value: float) -> str:
        """Return a position of an axis, mm or degrees, in the units of the program."""
        if axis in ROTARY_LETTERS:
            return number(value, MM_DIGITS)
        scale = self.state.scale
        if axis == "x" and self.turning.diameter:
            value *= 2.0
        return number(value / scale, MM_DIGITS if scale == 1.0 else INCH_DIGITS)

    def straight(
        self,
        mark: ExecutedLines,
        end: NDArray[np.float64],
        feed: float,
        *,
        in_machine: bool = False,
    ) -> None:
        """Write one straight move; with ``in_machine`` in machine coordinates (G53)."""
        zero = self.zero(mark)
        words = []
        moved = np.abs(end - self.position) > 1e-9
        for column in np.flatnonzero(moved).tolist():
            axis = self.axes[column]
            if in_machine:
                words.append(axis.upper() + self.number(axis, float(end[column])))
                continue
            there = self.number(axis, float(end[column] - zero[column]))
            if there != self.number(axis, float(self.position[column] - zero[column])):
                words.append(axis.upper() + there)
        if not words:
            return
        if self.turning.pitch:
            self._follow(mark, end, feed, words)
            return
        code = G.G0 if math.isnan(feed) else G.G1
        if in_machine:
            if G.G53 not in self.target.rules.g:
                raise self.cannot(mark, "the control has no machine coordinates (G53)", "")
            words.insert(0, f"G53 G{code.code:g}")
            if self.turning.offset and self.target.lathe.offsets == "D":
                # SINUMERIK's G53 keeps the offset of the tool.
                words.append("D0")
                self.turning.offset = 0
            self.state.motion = code
        elif self.state.motion != code:
            words.insert(0, f"G{code.code:g}")
            self.state.motion = code
        if code == G.G1:
            words += self.feed_words(feed, self._radius(zero, end))
        self.put(" ".join(words))
        self.position = end

    def _follow(
        self, mark: ExecutedLines, end: NDArray[np.float64], feed: float, words: list[str]
    ) -> None:
        """Write a move that follows the spindle; further ones go on without a stop."""
        turning, codes = self.turning, self.target.lathe
        assert turning.spindle is not None
        pitch = 60.0 * feed / turning.spindle.rpm
        if not turning.is_cut:
            if not math.isclose(pitch, turning.pitch, rel_tol=_SAME_LEAD):
                hint = "write the thread as moves of constant leads (G32, G33)"
                raise self.cannot(mark, "the lead of a thread changes from turn to turn", hint)
            pitch = turning.pitch
        x, z = (end - self.position)[[self.axes.index("x"), self.axes.index("z")]].tolist()
        lead = codes.lead_word(pitch / self.state.scale, (x, z), PITCH_DIGITS)
        if codes.lead != "K":
            self.set_plane("ZX")
        angle = "" if turning.is_cut else codes.angle_word(turning.angle)
        self.put(" ".join(word for word in (codes.thread, *words, lead, angle) if word))
        turning.is_cut, self.state.motion, self.position = True, UNKNOWN, end
        # F of a thread stays in effect as the feed.
        self.state.feed = UNKNOWN

    def _radius(self, zero: NDArray[np.float64], end: NDArray[np.float64]) -> float:
        """Return the largest radius of a move to a position, mm."""
        if "x" not in self.axes:
            return 0.0
        column = self.axes.index("x")
        return float(max(abs(place[column] - zero[column]) for place in (self.position, end)))

    def feed_words(self, feed: float, radius: float = 0.0) -> list[str]:
        """Return the word of a feed, mm/s, where it is not in effect.

        Args:
            feed: The feed.
            radius: Largest radius of the move, mm, on which a feed per revolution depends.
        """
        if self.state.feed_mode == "per-revolution":
            a_turn = self.turning.feed_per_turn(feed, radius)
            assert a_turn is not None
            value = a_turn / self.state.scale
            text = number(value, 6)
            if not math.isclose(float(text), value, rel_tol=1e-6):
                text = number(value, 10)
            if self.state.feed == text:
                return []
            self.state.feed = text
            return [f"F{text}"]
        per_minute = feed * 60.0 / self.state.scale
        if self.state.feed == per_minute:
            return []
        self.state.feed = per_minute
        digits = max(1, 7 - len(f"{per_minute:.0f}"))
        return [f"F{number(per_minute, digits)}"]

    def turn(self, mark: ExecutedLines, curve: Curve, feed: float) -> None:
        """Write one arc of at most a turn, or a straight move, from the present position."""
        if curve.plane is None:
            self.straight(mark, curve.end, feed)
            return
        self.set_plane(curve.plane)
        zero = self.zero(mark)
        code = G.G3 if curve.counter_clockwise else G.G2
        words = [f"G{code.code:g}"]
        plane = PLANE_AXES[curve.plane]
        here = self.position
        for column, axis in enumerate(self.axes):
            if axis in plane or abs(curve.end[column] - here[column]) > 1e-9:
                value = float(curve.end[column] - zero[column])
                words.append(axis.upper() + self.number(axis, value))
        for axis, center in zip(plane, curve.center, strict=True):
            column = self.axes.index(axis)
            written = float(self.number(axis, float(here[column] - zero[column])))
            written /= 2.0 if axis == "x" and self.turning.diameter else 1.0
            at = (center - zero[column]) / self.state.scale - written
            digits = MM_DIGITS if self.state.scale == 1.0 else INCH_DIGITS
            words.append(_CENTER[axis] + number(at, digits))
        words += self.feed_words(feed, self._radius(zero, curve.end))
        self.state.motion = code
        self.put(" ".join(words))
        self.position = curve.end

    def spline(self, mark: ExecutedLines, curve: Spline, feed: float) -> None:
        """Write a cubic B-spline with equal knot intervals, from the present position."""
        zero, form = self.zero(mark), self.target.spline
        plane = form == "G5.2"
        moves = np.ptp(curve.points, axis=0) > 1e-9
        letters = [letter for letter, moved in zip(self.axes, moves, strict=True) if moved or plane]
        letters = ["x", "y"] if plane else letters
        places = []
        for point in curve.points:
            numbers = ((letter, point[self.axes.index(letter)]) for letter in letters)
            places.append(
                " ".join(
                    letter.upper() + self.number(letter, float(value - zero[column]))
                    for letter, value in numbers
                    for column in (self.axes.index(letter),)
                )
            )
        feeds = self.feed_words(feed)
        if plane:
            self.set_plane("XY")
            self.put(" ".join(["G5.2 L4 P1", *feeds]))
            lines = [*places[1:], "G5.3"]
        elif form == "G6.2":
            self.put(" ".join(["G6.2 P4 K0.", places[0], *feeds]))
            knots = [max(0, min(k - 3, len(places) - 3)) for k in range(len(places) + 4)]
            lines = [f"K{knots[k]}. {place}" for k, place in enumerate(places) if k]
            lines += [f"K{knot}." for knot in knots[-4:]]
        else:
            self.put(" ".join(["BSPLINE SD=3", places[1], *feeds]))
            lines = places[2:]
        for line in lines:
            self.put(line)
        self.state.motion = UNKNOWN
        self.position = curve.points[-1]

    def set_plane(self, plane: Plane) -> None:
        """Write the plane of an arc, and that its centre counts from the start."""
        words = []
        if self.state.plane != plane:
            words.append(f"G{PLANE_CODES[plane].code:g}")
            self.state.plane = plane
        if self.state.arc_absolute:
            words.append("G91.1")
            self.state.arc_absolute = False
        if words:
            self.put(" ".join(words))

    def put(self, text: str) -> None:
        """Write a line."""
        self.put_bytes(text.encode())

    def put_bytes(self, text: bytes) -> None:
        """Write a line, with the block number that waits for one."""
        if self.label and text and text[:1] not in (b"(", b";"):
            text, self.label = self.label + text, b""
        self._file.write(text.rstrip(b"\r") + b"\n")
        self.line += 1

    def put_lines(self, text: bytes, count: int) -> None:
        """Write lines with their ends; the last one may have none."""
        self._file.write(text if text.endswith((b"\n", b"\r")) else text + b"\n")
        self.line += count

    def cannot(self, mark: ExecutedLines, message: str, hint: str) -> GcodeError:
        """Return the refusal of a line."""
        text = mark.text.decode(errors="replace")
        return GcodeError(
            Diagnostic(
                "convert-cannot",
                f"{self.target.rules.name} cannot do this: {message}",
                mark.file,
                mark.line,
                column=len(text) - len(text.lstrip()) + 1 if text.strip() else 0,
                length=max(len(without_comments(text).strip()), 1),
                text=text,
                hint=hint,
            )
        )

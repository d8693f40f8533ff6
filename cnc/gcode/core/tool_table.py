"""Tool table: data of the tools, and its file.

Lengths are in mm and angles in degrees, whatever the units of the program. The file has LinuxCNC's
format: one tool a line, words in any order, a comment after a semicolon::

    T1 P1 D6.0 Z+40.25   ;end mill 6 mm
    T9 P4 X12.5 Z31 D0.8 I95 J155 Q2 ;turning tool

T is the tool number, P the pocket, X to W the offsets of the axes, D the diameter, I the front and
J the back angle, Q the orientation of a turning tool (0 to 9).

Source: LinuxCNC, "Tool Table Format", G10 L1, "Lathe Tool Orientation".
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.reader.parameters import Parameters, replace_text
from cnc.gcode.reader.words import AXES
from cnc.model.diagnostics import Diagnostic, MachineFileError
from cnc.model.parameter_numbers import CURRENT_TOOL

MAX_TOOL = 99_999
MAX_POCKET = 99_999
ORIENTATIONS = 9

_WORD = re.compile(r"[ \t]*([A-Za-z])[ \t]*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))?")
_DATA = AXES | frozenset("TPDIJQ")
_WHOLE = {"T": MAX_TOOL, "P": MAX_POCKET, "Q": ORIENTATIONS}
_AXES_IN_ORDER = "XYZABCUVW"


@dataclass(frozen=True, slots=True)
class ToolEntry:
    """Data of one tool; ``offsets`` by axis letter.

    ``radius_wear`` is added to the radius and ``wear`` to the offset of each axis (FANUC). The file
    does not hold these two.
    """

    number: int
    pocket: int = 0
    offsets: dict[str, float] = field(default_factory=dict)
    diameter: float = 0.0
    front_angle: float = 0.0
    back_angle: float = 0.0
    orientation: int = 0
    wear: dict[str, float] = field(default_factory=dict)
    radius_wear: float = 0.0
    comment: str = ""

    @property
    def radius(self) -> float:
        """Radius for cutter compensation in mm, wear included."""
        return self.diameter / 2.0 + self.radius_wear

    def offset(self, letter: str) -> float:
        """Offset of an axis in mm or degrees, wear included."""
        return self.offsets.get(letter, 0.0) + self.wear.get(letter, 0.0)


class ToolTable:
    """Tools by number. ``file`` is the file that they were read from, or empty."""

    def __init__(self, entries: Iterable[ToolEntry] = (), *, file: str = "") -> None:
        self.file = file
        self._entries = {entry.number: entry for entry in entries}
        self._written: set[int] = set()

    @property
    def changed(self) -> bool:
        """Whether a program has changed the table."""
        return bool(self._written)

    @classmethod
    def load(cls, path: Path) -> ToolTable:
        """Read a table from a file.

        Raises:
            MachineFileError: The file can't be read, or a line is wrong; with line and column.
        """
        file = str(path)
        try:
            text = path.read_text(encoding="utf-8-sig", errors="replace")
        except OSError as error:
            raise MachineFileError(
                Diagnostic(
                    "tool-table-unreadable", f"the tool table can't be read: {error.strerror}", file
                )
            ) from None
        entries: dict[int, ToolEntry] = {}
        for number, line in enumerate(text.splitlines(), start=1):
            try:
                entry = _entry(line)
                if entry and entry.number in entries:
                    raise _wrong(
                        "tool-repeated",
                        f"T{entry.number} is in the table twice",
                        line.upper().index("T") + 1,
                    )
            except MachineFileError as error:
                raise error.at(file=file, line=number, text=line) from None
            if entry:
                entries[entry.number] = entry
        return cls(entries.values(), file=file)

    def save(self, path: Path) -> None:
        """Write the changed tools to a file. Its other lines stay as they are.

        Raises:
            UsageError: ``unwritable-file``.
        """
        lines = (
            path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
            if path.exists()
            else []
        )
        left = dict.fromkeys(sorted(self._written))
        for index, line in enumerate(lines):
            with suppress(MachineFileError):
                entry = _entry(line)
                if entry and entry.number in left:
                    lines[index] = _line(self._entries[entry.number])
                    del left[entry.number]
        lines += [_line(self._entries[number]) for number in left]
        replace_text(path, "".join(line + "\n" for line in lines), "the tool table")

    def tool(self, number: int) -> ToolEntry | None:
        """Return a tool by number, or None."""
        return self._entries.get(number)

    def put(self, entry: ToolEntry) -> None:
        """Change a tool; the file stays as it is."""
        self._entries[entry.number] = entry
        self._written.add(entry.number)

    def reload(self) -> None:
        """Read the file again, if there is one. Tools changed by the program stay.

        Raises:
            MachineFileError: As :meth:`load`.
        """
        if self.file:
            written = {number: self._entries[number] for number in self._written}
            self._entries = {
                entry.number: entry for entry in ToolTable.load(Path(self.file))
            } | written

    def __iter__(self) -> Iterator[ToolEntry]:
        return iter(self._entries.values())

    def __len__(self) -> int:
        return len(self._entries)

    def bind(self, parameters: Parameters, loaded: Callable[[], int]) -> None:
        """Show the tool in the spindle as parameters.

        5400 is its number, 5401 to 5409 its offsets, 5410 the diameter, 5411 and 5412 the angles,
        5413 the orientation.

        Args:
            parameters: The parameters of the program.
            loaded: Returns the number of the tool in the spindle, 0 for none.
        """

        def entry() -> ToolEntry:
            return self.tool(loaded()) or ToolEntry(0)

        readings: list[Callable[[], float]] = [
            lambda: float(loaded()),
            *(_offset_reading(entry, letter) for letter in _AXES_IN_ORDER),
            lambda: 2.0 * entry().radius,
            lambda: entry().front_angle,
            lambda: entry().back_angle,
            lambda: float(entry().orientation),
        ]
        for number, read in enumerate(readings, start=CURRENT_TOOL):
            parameters.bind(number, read)
        parameters.bind("_current_tool", readings[0])


def _offset_reading(entry: Callable[[], ToolEntry], letter: str) -> Callable[[], float]:
    return lambda: entry().offset(letter)


def _entry(line: str) -> ToolEntry | None:
    """The tool of a line; None for a line without words."""
    words = _words(line)
    if not words:
        return None
    for letter, (value, column) in words.items():
        if (most := _WHOLE.get(letter)) is not None and not (
            value.is_integer() and 0 <= value <= most
        ):
            raise _wrong(
                "value-out-of-range",
                f"{letter}{value:g}: {letter} must be a whole number from 0 to {most}",
                column,
            )
    if "T" not in words:
        raise _wrong(
            "tool-number-missing",
            "the line has no tool number",
            next(iter(words.values()))[1],
            "begin with T and the tool's number",
        )
    values = {letter: value for letter, (value, _) in words.items()}
    return ToolEntry(
        number=int(values["T"]),
        pocket=int(values.get("P", 0.0)),
        offsets={letter: values[letter] for letter in _AXES_IN_ORDER if letter in values},
        diameter=values.get("D", 0.0),
        front_angle=values.get("I", 0.0),
        back_angle=values.get("J", 0.0),
        orientation=int(values.get("Q", 0.0)),
        comment=line.partition(";")[2].strip(),
    )


def _line(entry: ToolEntry) -> str:
    """A tool as a line of the file, without wear.

    If wear were added to the length, the next program would add it again.
    """
    numbers = entry.offsets | {
        "D": entry.diameter,
        "I": entry.front_angle,
        "J": entry.back_angle,
        "Q": entry.orientation,
    }
    words = [
        f"T{entry.number}",
        f"P{entry.pocket}",
        *(f"{letter}{_plain(number)}" for letter, number in numbers.items() if number),
    ]
    return " ".join(words) + (f" ;{entry.comment}" if entry.comment else "")


def _plain(number: float) -> str:
    """A number without an exponent, exact."""
    return format(Decimal(repr(number)), "f")


def _words(line: str) -> dict[str, tuple[float, int]]:
    """Value and column (from 1) of every word before the comment, by letter."""
    body = line.partition(";")[0].rstrip()
    words: dict[str, tuple[float, int]] = {}
    at = 0
    while at < len(body):
        word = _WORD.match(body, at)
        if word is None:
            column = at + len(body[at:]) - len(body[at:].lstrip()) + 1
            raise _wrong(
                "tool-table-malformed",
                f"{body[column - 1]!r} is not part of a word",
                column,
                "write words such as T1 P1 D6 Z40.5 ;comment",
            )
        letter, column = word[1].upper(), word.start(1) + 1
        if letter not in _DATA:
            raise _wrong(
                "tool-table-malformed",
                f"{letter} is not a word of the tool table",
                column,
                "its words are T P X Y Z A B C U V W D I J Q",
            )
        if word[2] is None:
            raise _wrong("number-missing", f"a number is missing after {letter}", column)
        if letter in words:
            raise _wrong("word-repeated", f"{letter} is given twice in this line", column)
        value = float(word[2])
        if not math.isfinite(value):
            raise _wrong("value-out-of-range", f"the number of {letter} is too large", column)
        words[letter] = value, column
        at = word.end()
    return words


def _wrong(code: str, message: str, column: int, hint: str = "") -> MachineFileError:
    return MachineFileError(Diagnostic(code, message, column=column, hint=hint))


# Protocols of the positions of joints, tip and tool under tool-tip control.

Floats = NDArray[np.float64]
Offset = tuple[float, float, float]


class Swing(Protocol):
    """A change of the orientation along a great circle; angles in degrees."""

    @property
    def end(self) -> tuple[float, float]:
        """Tilt and turn at the end."""

    @property
    def nearest(self) -> float:
        """Least angle between the tool and the axis of C."""

    @property
    def parameters(self) -> Floats:
        """Share of the way of each control point (n,); empty where both angles change linearly."""

    @property
    def angles(self) -> Floats:
        """Control points of tilt and turn (n, 2) of Bezier curves of degree 7."""

    @property
    def knots(self) -> Floats:
        """Knots of the curves, 0 to 1."""


class ToolTip(Protocol):
    """Positions of the joints and of the tip of a machine, mm or degrees (axes,)."""

    @property
    def rotary(self) -> tuple[int, int]:
        """Columns of the axis that tilts and of the one that turns."""

    @property
    def points_missing(self) -> tuple[str, ...]:
        """Keys of the points of the rotary axes that the machine file does not give."""

    def joints(self, tip: list[float], offset: Offset) -> list[float]:
        """Return the joints of a tip with a tool offset (X, Y, Z)."""

    def tip(self, joints: list[float], offset: Offset) -> list[float]:
        """Return the tip of joints."""

    def angles(self, here: list[float], direction: Floats) -> tuple[float, float]:
        """Return tilt and turn of a direction of the tool (3,), from a position (axes,)."""

    def swing(self, here: list[float], direction: Floats) -> Swing | None:
        """Return the way from a position (axes,) to a direction of the tool (3,).

        None for the opposite direction; without an end where it passes the axis of C.
        """

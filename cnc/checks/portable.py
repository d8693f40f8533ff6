"""Portability of a program: the differences between dialects that read the same text.

The program is read under each dialect, and the canonical blocks are compared. A dialect may refuse
a word (``not-portable``), or interpret it differently, so that other blocks result
(``reads-differently``). After a refused line the rest is read without that line, so that every
word that the dialect lacks is reported in one check.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cnc.gcode.dialects import NAMES
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Block, Polyline
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError, UsageError
from cnc.model.motion_commands import apart
from cnc.model.units import per_minute

Reader = Callable[[str, Text], Iterator[Block]]
"""Reads a text under a dialect."""

MAX_REFUSED = 20
"""Refused lines of a dialect that are searched for."""
MAX_BYTES = 4_000_000
"""Size of a program that is read on after a refused line: each such line costs a full reading."""
SAME = 1e-9
"""mm, mm/s or s. Numbers of two dialects that differ by less are equal."""
DIALECT_FAULTS = frozenset(
    (
        "axis-not-in-dialect",
        "code-not-in-dialect",
        "code-not-supported",
        "code-unknown",
        "syntax-not-in-dialect",
        "word-not-in-dialect",
    )
)
"""Faults of the dialect itself, which do not follow from a line that was left out."""


def dialects_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of dialects without repetitions.

    Raises:
        UsageError: ``unknown-dialect``.
    """
    for name in names:
        if name not in NAMES:
            raise UsageError(
                Diagnostic(
                    "unknown-dialect",
                    f"there is no dialect {name!r}",
                    hint=f"the dialects are {', '.join(NAMES)}",
                )
            )
    return tuple(dict.fromkeys(names))


@dataclass(frozen=True, slots=True)
class ProgramText:
    """A program that can be read under several dialects.

    Attributes:
        path: the file with the text.
        name: its name in messages.
        read: reads a text under a dialect.
    """

    path: Path
    name: str
    read: Reader

    def blocks(self, dialect: str) -> Iterator[Block]:
        """Yield the blocks of the program under ``dialect``."""
        return self.read(dialect, Text.of_file(self.path, self.name))


def portability(
    source: ProgramText, dialect: str, others: Sequence[str], faults: Sequence[CncError] = ()
) -> list[GcodeError]:
    """Return the lines that other dialects refuse or interpret differently.

    Args:
        source: the program.
        dialect: the dialect of the program.
        others: the dialects to compare with.
        faults: the faults under ``dialect``, which are not reported again.
    """
    reported = {_place(fault.diagnostic) for fault in faults}
    understood = not any(isinstance(fault, GcodeError) for fault in faults)
    findings: list[GcodeError] = []
    for other in others:
        refused = list(_refused(source, other))
        findings += [
            _not_portable(refusal, other) for refusal in refused if _place(refusal) not in reported
        ]
        if not refused and understood and other != dialect:
            findings += _differences(source, dialect, other)
    return findings


def _place(finding: Diagnostic) -> tuple[str, str, int, int]:
    return finding.code, finding.file, finding.line, finding.column


def _refused(source: ProgramText, dialect: str) -> Iterator[Diagnostic]:
    """Yield the faults under ``dialect``, each found without the lines of those before."""
    fault = _fault(source.blocks(dialect))
    if fault is None:
        return
    yield fault.diagnostic
    if source.path.stat().st_size > MAX_BYTES:
        return
    text = Text.of_file(source.path, source.name)
    lines = [_line(text, number) for number in range(1, _count(text) + 1)]
    for _ in range(MAX_REFUSED - 1):
        if fault.diagnostic.file != source.name or not fault.diagnostic.line:
            return
        lines[fault.diagnostic.line - 1] = ""
        fault = _fault(source.read(dialect, Text.of_lines(lines, source.name)))
        if fault is None:
            return
        if fault.diagnostic.code in DIALECT_FAULTS:
            yield fault.diagnostic


def _fault(blocks: Iterator[Block]) -> GcodeError | None:
    try:
        for _ in blocks:
            pass
    except GcodeError as error:
        return error
    return None


def _count(text: Text) -> int:
    while text.window(text.lines + 1) is not None:
        pass
    return text.lines


def _line(text: Text, number: int) -> str:
    window = text.window(number)
    assert window is not None
    return window.text(number - window.first)


def _not_portable(refusal: Diagnostic, dialect: str) -> GcodeError:
    message = f"{dialect} refuses this: {refusal.message} ({refusal.code})"
    # A hint to select another dialect does not help a user who asks about this one.
    hint = "" if refusal.hint.startswith("use --dialect") else refusal.hint
    return GcodeError(
        Diagnostic(
            "not-portable",
            message,
            refusal.file,
            refusal.line,
            refusal.column,
            refusal.length,
            refusal.text,
            hint,
        )
    )


class Difference(NamedTuple):
    """A line that two dialects interpret differently.

    Attributes:
        file: file of the line.
        line: source line.
        theirs: the block under the other dialect.
        ours: the block under the dialect of the program.
        last: whether the blocks behind it cannot be compared.
    """

    file: str
    line: int
    theirs: str
    ours: str
    last: bool


def _differences(source: ProgramText, dialect: str, other: str) -> Iterator[GcodeError]:
    """Yield the differing lines, each once, up to the first different position."""
    reported: set[tuple[str, int]] = set()
    for difference in _compared(apart(source.blocks(dialect)), apart(source.blocks(other))):
        if (difference.file, difference.line) not in reported:
            reported.add((difference.file, difference.line))
            if not (difference.theirs and difference.ours):
                what = f"only {other if difference.theirs else dialect} continues to this line"
            else:
                what = f"{difference.theirs} in {other}, {difference.ours} in {dialect}"
            message = f"{other} reads this differently: {what}"
            hint = "write words that both read alike, or remove those that only one of them needs"
            yield GcodeError(
                Diagnostic(
                    "reads-differently", message, difference.file, difference.line, hint=hint
                )
            )
        if difference.last:
            return


def _compared(ours: Iterator[Block], theirs: Iterator[Block]) -> Iterator[Difference]:
    mine, other = next(ours, None), next(theirs, None)
    while mine is not None and other is not None:
        if isinstance(mine, Polyline) and isinstance(other, Polyline):
            count = min(len(mine.points), len(other.points))
            yield from _moves_compared(_part(mine, 0, count), _part(other, 0, count))
            mine = _rest(mine, count) or next(ours, None)
            other = _rest(other, count) or next(theirs, None)
            continue
        if type(mine) is not type(other):
            yield Difference(mine.file, mine.line, _name(other), _name(mine), True)
            return
        for difference in _fields_compared(mine, other):
            yield difference
            if difference.last:
                return
        mine, other = next(ours, None), next(theirs, None)
    left = mine if mine is not None else other
    if left is not None:
        name = _name(left)
        yield Difference(
            left.file, left.line, "" if mine is left else name, name if mine is left else "", True
        )


def _fields_compared(mine: Block, other: Block) -> Iterator[Difference]:
    """Yield the differing fields of two blocks of one class."""
    moves = hasattr(mine, "end") or hasattr(mine, "control_points")
    for field in fields(mine):
        a, b = getattr(mine, field.name), getattr(other, field.name)
        if field.compare and not _same(a, b):
            yield Difference(
                mine.file,
                mine.line,
                f"{_name(mine)}, {field.name} {_shown(field.name, b)}",
                _shown(field.name, a),
                moves and field.name != "feed",
            )


def _rest(block: Polyline, begin: int) -> Polyline | None:
    return _part(block, begin, len(block.points)) if begin < len(block.points) else None


def _part(block: Polyline, begin: int, end: int) -> Polyline:
    part = slice(begin, end)
    return Polyline(
        block.file,
        int(block.lines[begin]),
        block.points[part],
        block.feeds[part],
        block.lines[part],
    )


def _moves_compared(mine: Polyline, other: Polyline) -> Iterator[Difference]:
    """Yield the first different position of as many straight moves, and a different feed before."""
    differ = (mine.lines != other.lines) | (np.abs(mine.points - other.points).max(axis=1) > SAME)
    differ |= np.isnan(mine.feeds) != np.isnan(other.feeds)
    first = int(np.argmax(differ)) if differ.any() else len(differ)
    feeds = np.abs(mine.feeds[:first] - other.feeds[:first]) > SAME
    if feeds.any():
        row = int(np.argmax(feeds))
        theirs, ours = (
            f"{per_minute(float(block.feeds[row])):.6g} mm/min" for block in (other, mine)
        )
        yield Difference(mine.file, int(mine.lines[row]), f"a feed of {theirs}", ours, False)
    if first < len(differ):
        theirs, ours = _move(other, first), _move(mine, first)
        yield Difference(mine.file, int(mine.lines[first]), theirs, ours, True)


def _move(block: Polyline, row: int) -> str:
    kind = "a rapid move" if np.isnan(block.feeds[row]) else "a feed move"
    return f"{kind} to {_shown('end', block.points[row])} in line {int(block.lines[row])}"


def _same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape == b.shape and bool((np.abs(a - b) <= SAME).all())
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= SAME
    return a == b


def _name(block: Block) -> str:
    """Return the class of a block in words: ``NurbsFeed`` is "nurbs feed"."""
    return "".join(
        f" {letter.lower()}" if letter.isupper() else letter for letter in type(block).__name__
    ).strip()


def _shown(name: str, value: object) -> str:
    if isinstance(value, np.ndarray | tuple):
        return "(" + ", ".join(f"{float(number):.6g}" for number in np.ravel(value)) + ")"
    if name == "feed" and isinstance(value, float):
        return f"{per_minute(value):.6g} mm/min"
    return f"{value:.6g}" if isinstance(value, float) else str(value)

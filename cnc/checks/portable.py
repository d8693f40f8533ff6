"""What other controllers make of a program: it is read under each of their dialects, and the
canonical blocks are compared.

A dialect refuses a word, which is ``not-portable``, or takes it for something else, which is
``reads-differently``: other blocks come out. The words of a refused line are left out and the rest
is read on, so that every word that the dialect lacks is told at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from cnc.gcode.dialects import NAMES
from cnc.gcode.syntax.source_text import Text
from cnc.model.blocks import Block, Polyline
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError, UsageError
from cnc.model.units import per_minute

Reader = Callable[[str, Text], Iterator[Block]]
"""Reads a text under a dialect."""

MOST_REFUSED = 20
"""Refused lines of a dialect that are looked for."""
LONGEST = 4_000_000
"""Bytes of a program that is read on after a refused line: it is read anew for each."""
SAME = 1e-9
"""mm, mm/s, s. Numbers of two dialects that differ by less are the same."""
LACKING = frozenset(
    (
        "axis-not-in-dialect",
        "code-not-in-dialect",
        "code-not-supported",
        "code-unknown",
        "syntax-not-in-dialect",
        "word-not-in-dialect",
    )
)
"""Faults that are the dialect's and no consequence of a line that was left out."""


def dialects_of(names: Sequence[str]) -> tuple[str, ...]:
    """The dialects of these names, each once. UsageError ``unknown-dialect``."""
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


def portability(
    program: Path,
    name: str,
    read: Reader,
    spoken: str,
    others: Sequence[str],
    faults: Sequence[CncError] = (),
) -> list[GcodeError]:
    """What the dialects ``others`` refuse or read in another way than the one that is ``spoken``,
    which finds ``faults`` itself.
    """
    wrong = {_place(fault.diagnostic) for fault in faults}
    understood = not any(isinstance(fault, GcodeError) for fault in faults)
    return list(_findings(program, name, read, spoken if understood else None, others, wrong))


def _place(found: Diagnostic) -> tuple[str, str, int, int]:
    return found.code, found.file, found.line, found.column


def _findings(
    program: Path,
    name: str,
    read: Reader,
    spoken: str | None,
    others: Sequence[str],
    wrong: set[tuple[str, str, int, int]],
) -> Iterator[GcodeError]:
    for other in others:
        refused = list(_refused(program, name, read, other))
        for fault in refused:
            if _place(fault) not in wrong:
                yield _not_portable(fault, other)
        if not refused and spoken is not None and other != spoken:
            yield from _differences(
                read(spoken, Text.of_file(program, name)),
                read(other, Text.of_file(program, name)),
                spoken,
                other,
            )


def _refused(program: Path, name: str, read: Reader, dialect: str) -> Iterator[Diagnostic]:
    fault = _fault(read(dialect, Text.of_file(program, name)))
    if fault is None:
        return
    yield fault.diagnostic
    if program.stat().st_size > LONGEST:
        return
    text = Text.of_file(program, name)
    lines = [_line(text, number) for number in range(1, _count(text) + 1)]
    for _ in range(MOST_REFUSED - 1):
        if fault.diagnostic.file != name or not fault.diagnostic.line:
            return
        lines[fault.diagnostic.line - 1] = ""
        fault = _fault(read(dialect, Text.of_lines(lines, name)))
        if fault is None:
            return
        if fault.diagnostic.code in LACKING:
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


def _not_portable(found: Diagnostic, dialect: str) -> GcodeError:
    message = f"{dialect} refuses this: {found.message} ({found.code})"
    # to name another dialect is no help to somebody who asks for this one
    hint = "" if found.hint.startswith("use --dialect") else found.hint
    return GcodeError(
        Diagnostic(
            "not-portable",
            message,
            found.file,
            found.line,
            found.column,
            found.length,
            found.text,
            hint,
        )
    )


def _differences(
    ours: Iterator[Block], theirs: Iterator[Block], spoken: str, other: str
) -> Iterator[GcodeError]:
    """Where the blocks differ, each line once, up to where the ways part."""
    told: set[tuple[str, int]] = set()
    for block, what, apart in _compared(ours, theirs):
        file, line = block
        if (file, line) not in told:
            told.add((file, line))
            message = f"{other} reads this differently: {what.format(other=other, spoken=spoken)}"
            hint = "write what both understand in one way, or take out what only one of them needs"
            yield GcodeError(Diagnostic("reads-differently", message, file, line, hint=hint))
        if apart:
            return


def _compared(
    ours: Iterator[Block], theirs: Iterator[Block]
) -> Iterator[tuple[tuple[str, int], str, bool]]:
    """Place, what differs there, and whether the two can't be compared any further."""
    mine, other = next(ours, None), next(theirs, None)
    while mine is not None and other is not None:
        if isinstance(mine, Polyline) and isinstance(other, Polyline):
            count = min(len(mine.points), len(other.points))
            yield from _moves_compared(_part(mine, 0, count), _part(other, 0, count))
            mine = (
                _part(mine, count, len(mine.points))
                if count < len(mine.points)
                else next(ours, None)
            )
            other = (
                _part(other, count, len(other.points))
                if count < len(other.points)
                else next(theirs, None)
            )
            continue
        if type(mine) is not type(other):
            yield (
                (mine.file, mine.line),
                f"{_name(other)} in {{other}}, {_name(mine)} in {{spoken}}",
                True,
            )
            return
        for field in fields(mine):
            a, b = getattr(mine, field.name), getattr(other, field.name)
            if field.compare and not _same(a, b):
                moves = hasattr(mine, "end") or hasattr(mine, "control_points")
                apart = moves and field.name != "feed"
                yield (
                    (mine.file, mine.line),
                    f"{_name(mine)}, {field.name} {_shown(field.name, b)} in {{other}}, {_shown(field.name, a)} in {{spoken}}",
                    apart,
                )
                if apart:
                    return
        mine, other = next(ours, None), next(theirs, None)
    left = mine if mine is not None else other
    if left is not None:
        who = "{spoken}" if mine is not None else "{other}"
        yield (left.file, left.line), f"only {who} goes on to this line", True


def _part(block: Polyline, begin: int, end: int) -> Polyline:
    part = slice(begin, end)
    return Polyline(
        block.file,
        int(block.lines[begin]),
        block.points[part],
        block.feeds[part],
        block.lines[part],
    )


def _moves_compared(mine: Polyline, other: Polyline) -> Iterator[tuple[tuple[str, int], str, bool]]:
    """As :func:`_compared`, for as many straight moves of each: the first way that differs, and the
    first feed before it.
    """
    ways = (mine.lines != other.lines) | (np.abs(mine.points - other.points).max(axis=1) > SAME)
    ways |= np.isnan(mine.feeds) != np.isnan(other.feeds)
    first = int(np.argmax(ways)) if ways.any() else len(ways)
    feeds = np.abs(mine.feeds[:first] - other.feeds[:first]) > SAME
    if feeds.any():
        row = int(np.argmax(feeds))
        theirs, ours = (
            f"{per_minute(float(block.feeds[row])):.6g} mm/min" for block in (other, mine)
        )
        yield (
            (mine.file, int(mine.lines[row])),
            f"a feed of {theirs} in {{other}}, {ours} in {{spoken}}",
            False,
        )
    if first < len(ways):
        theirs, ours = _move(other, first), _move(mine, first)
        yield (
            (mine.file, int(mine.lines[first])),
            f"{theirs} in {{other}}, {ours} in {{spoken}}",
            True,
        )


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
    """A block in a word or two: ``NurbsFeed`` is "nurbs feed"."""
    return "".join(
        f" {letter.lower()}" if letter.isupper() else letter for letter in type(block).__name__
    ).strip()


def _shown(name: str, value: object) -> str:
    if isinstance(value, np.ndarray | tuple):
        return "(" + ", ".join(f"{float(each):.6g}" for each in np.ravel(value)) + ")"
    if name == "feed" and isinstance(value, float):
        return f"{per_minute(value):.6g} mm/min"
    return f"{value:.6g}" if isinstance(value, float) else str(value)

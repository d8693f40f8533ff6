"""Repairs of findings in the text of a program (``cncrun check --fix``), and their proof.

A safe repair keeps the blocks: the text is read before and after it, and a repair whose text gives
other blocks is left out. A repair of an error can't keep blocks, because there are none behind the
error: it is unsafe, and is left out where the error stays.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from cnc.gcode.core.feed_codes import point_behind, without_point
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.parser import parse_line
from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import CncError, Diagnostic, Edit, GcodeError
from cnc.session.options import RunOptions
from cnc.session.program_reader import InlineProgram
from cnc.session.rewriting import fingerprint
from cnc.session.session import Session

MOST_ROUNDS = 200
"""Readings of a program after a repair. Each error needs one: a reading ends at the first."""
_LINE_END = re.compile(rb"\r\n|\n|\r")
_MAYBE_WHOLE = re.compile(r"[XYZABCUVWIJKRQ][ \t]*[-+]?[0-9]+(?![0-9.])", re.IGNORECASE)
"""A distance without a decimal point, or a count."""


Place = tuple[str, int, int]
"""Code, line and column of a finding."""


class Reading(NamedTuple):
    """A reading of a program, to its first error.

    Attributes:
        blocks: Digests of the blocks.
        findings: Warnings and notes, then the error.
        rules: Dialect; None if it can't be told.
    """

    blocks: dict[str, str]
    findings: list[Diagnostic]
    rules: Dialect | None

    @property
    def error(self) -> Diagnostic | None:
        """The error; None without one."""
        return next((last for last in self.findings[-1:] if last.severity == "error"), None)

    @property
    def end(self) -> tuple[str, int] | None:
        """Code and line of the error that ends the reading; None for the end of the program."""
        return None if self.error is None else (self.error.code, self.error.line)


class ChangedLine(NamedTuple):
    """A line before and after a repair; ``new`` holds further lines where the repair adds some."""

    line: int
    old: str
    new: str


class Applied(NamedTuple):
    """A repair that was made: its finding, and the lines that it changed."""

    finding: Diagnostic
    lines: tuple[ChangedLine, ...]


@dataclass(frozen=True)
class Repaired:
    """A program after its repairs.

    Attributes:
        text: The text before.
        new: The text after.
        applied: The repairs in the order in which they were made.
    """

    text: bytes
    new: bytes
    applied: list[Applied]


class SourceLines:
    """The lines of a program, for edits.

    Attributes:
        lines: Bytes of the lines, without their ends.
    """

    def __init__(self, text: bytes) -> None:
        ends = [match.span() for match in _LINE_END.finditer(text)]
        begins = [0, *(end for _, end in ends)]
        self.lines = [text[a:b] for a, (b, _) in zip(begins, ends, strict=False)]
        self.lines.append(text[begins[-1] :])
        self._ends = [text[a:b] for a, b in ends]
        self._newline = self._ends[0] if self._ends else b"\n"

    def text(self, line: int) -> str:
        """Return a line (from 1), read as the reader reads it."""
        return self._decoded(line)[0]

    def _decoded(self, line: int) -> tuple[str, str]:
        """Return a line, and the name of its encoding."""
        data = self.lines[line - 1]
        if line == 1:
            data = data.removeprefix(b"\xef\xbb\xbf")
        try:
            return data.decode(), "utf-8"
        except UnicodeDecodeError:
            return data.decode("latin-1"), "latin-1"

    def edit(self, line: int, edits: Iterable[Edit]) -> ChangedLine:
        """Carry out edits of a line (from 1) that do not overlap."""
        old, encoding = self._decoded(line)
        new = edited(old, edits)
        mark = b"\xef\xbb\xbf" if self.lines[line - 1].startswith(b"\xef\xbb\xbf") else b""
        data = new.replace("\n", self._newline.decode()).encode(encoding)
        self.lines[line - 1] = (mark if line == 1 else b"") + data
        return ChangedLine(line, old, new)

    def joined(self) -> bytes:
        """Return the whole text."""
        return b"".join(a + b for a, b in zip(self.lines, [*self._ends, b""], strict=True))


def edited(text: str, edits: Iterable[Edit]) -> str:
    """Return a line after edits that do not overlap."""
    for edit in sorted(edits, key=lambda edit: edit.column, reverse=True):
        text = text[: edit.column - 1] + edit.text + text[edit.column - 1 + edit.length :]
    return text


def read(name: str, text: bytes, machine: Machine, options: RunOptions) -> Reading:
    """Read a text as a program, with every finding of its language."""
    session = Session(InlineProgram(name, text), machine, options)
    findings: list[Diagnostic] = []

    def blocks() -> Iterator[Block]:
        try:
            yield from session.blocks(findings.append)
        except CncError as error:
            findings.append(error.diagnostic)

    digests = fingerprint(blocks())
    wanted = options.selection.wants
    try:
        rules = session.rules()
    except CncError:
        rules = None
    return Reading(digests, [finding for finding in findings if wanted(finding)], rules)


def repaired(
    name: str, text: bytes, machine: Machine, options: RunOptions, *, unsafe: bool
) -> Repaired:
    """Return a program after the repairs of its findings, each of them proved.

    Args:
        name: Name of the program in messages; subroutines are searched for beside it.
        text: The program.
        machine: The machine that it is for.
        options: How the check reads it, and the findings that are wanted.
        unsafe: Whether unsafe repairs are made too.
    """
    options = _without_lengths(options)
    before, new = read(name, text, machine, options), text
    applied: list[Applied] = []
    refused: set[Place] = set()
    batch: list[Diagnostic] = []
    for _ in range(MOST_ROUNDS):
        source = SourceLines(new)
        batch = batch or _batch(before, source, name, refused, unsafe=unsafe)
        if not batch:
            break
        changes = _apply(source, batch)
        after = read(name, source.joined(), machine, options)
        if _is_proved(before, after, batch):
            before, new = after, source.joined()
            applied += changes
            batch = []
        elif len(batch) == 1:
            refused.add(_place(batch.pop()))
        else:
            batch = batch[: len(batch) // 2]
    return Repaired(text, new, applied)


def repaired_at(
    name: str, text: bytes, machine: Machine, options: RunOptions, place: Place
) -> Repaired:
    """Return a program after the repair of one finding; unchanged if no repair of it is proved.

    Args:
        name: As for :func:`repaired`, and so are ``text``, ``machine`` and ``options``.
        text: The program.
        machine: The machine that it is for.
        options: How the check reads it.
        place: Code, line and column of the finding.
    """
    options = _without_lengths(options)
    before, source = read(name, text, machine, options), SourceLines(text)
    for finding in before.findings:
        if finding.fix and finding.file == name and _place(finding) == place:
            batch = [complete(finding, source, before.rules)]
            applied = _apply(source, batch)
            new = source.joined()
            if _is_proved(before, read(name, new, machine, options), batch):
                return Repaired(text, new, applied)
            break
    return Repaired(text, text, [])


def _without_lengths(options: RunOptions) -> RunOptions:
    """Return options with which a program can be read without a table of its tools."""
    return replace(options, tool_lengths=options.tool_lengths or "zero")


def complete(finding: Diagnostic, source: SourceLines, rules: Dialect | None) -> Diagnostic:
    """Return a finding with the edits of all places that it stands for.

    A missing decimal point is reported at the first of them.
    """
    fix = finding.fix
    if fix is None or rules is None or finding.code != "decimal-point-missing":
        return finding
    syntax = rules.syntax()
    edits = list(fix.edits)
    for line in range(finding.line + 1, len(source.lines) + 1):
        text = source.text(line)
        if not _MAYBE_WHOLE.search(text):
            continue
        try:
            statement = parse_line(text, syntax)
        except GcodeError:
            continue
        edits += [point_behind(word, line) for word in without_point(statement, rules)]
    first = parse_line(source.text(finding.line), syntax)
    here = [point_behind(word, finding.line) for word in without_point(first, rules)]
    whole = (*here, *edits[len(fix.edits) :])
    return replace(finding, fix=replace(fix, title="write each decimal point", edits=whole))


def _place(finding: Diagnostic) -> Place:
    return finding.code, finding.line, finding.column


def _batch(
    reading: Reading,
    source: SourceLines,
    name: str,
    refused: set[Place],
    *,
    unsafe: bool,
) -> list[Diagnostic]:
    """Return findings whose repairs can be made at once: safe ones, else unsafe ones."""
    with_fix = [
        complete(finding, source, reading.rules)
        for finding in reading.findings
        if finding.fix and finding.file == name and _place(finding) not in refused
    ]
    for safe in (True, False) if unsafe else (True,):
        taken: dict[int, list[tuple[int, int]]] = {}
        batch = []
        for finding in with_fix:
            assert finding.fix is not None
            if finding.fix.safe != safe:
                continue
            spans = [
                (edit.line or finding.line, edit.column, edit.column + edit.length)
                for edit in finding.fix.edits
            ]
            if not any(
                a <= end and begin <= b
                for line, begin, end in spans
                for a, b in taken.get(line, ())
            ):
                batch.append(finding)
                for line, begin, end in spans:
                    taken.setdefault(line, []).append((begin, end))
        if batch:
            return batch
    return []


def _apply(source: SourceLines, batch: Iterable[Diagnostic]) -> list[Applied]:
    """Make the repairs of findings. A line with several repairs shows all of them."""
    edits: dict[int, list[Edit]] = {}
    lines: list[tuple[Diagnostic, list[int]]] = []
    for finding in batch:
        assert finding.fix is not None
        numbers = [edit.line or finding.line for edit in finding.fix.edits]
        lines.append((finding, sorted(set(numbers))))
        for number, edit in zip(numbers, finding.fix.edits, strict=True):
            edits.setdefault(number, []).append(edit)
    changed = {number: source.edit(number, edits[number]) for number in sorted(edits)}
    return [Applied(finding, tuple(changed[n] for n in numbers)) for finding, numbers in lines]


def _is_proved(before: Reading, after: Reading, batch: Iterable[Diagnostic]) -> bool:
    """Return whether repairs do what they should, by the readings before and after them."""

    def counts(reading: Reading) -> Counter[tuple[str, int]]:
        return Counter((finding.code, finding.line) for finding in reading.findings)

    old, new = counts(before), counts(after)
    for finding in batch:
        assert finding.fix is not None
        if finding.severity == "error":
            if not _is_gone(finding, after.error):
                return False
        elif new[finding.code, finding.line] >= old[finding.code, finding.line] or (
            finding.fix.safe and (after.blocks, after.end) != (before.blocks, before.end)
        ):
            return False
    return after.error is None or before.error is not None


def _is_gone(repaired: Diagnostic, error: Diagnostic | None) -> bool:
    """Return whether an error that was repaired is gone; the next one may be any other.

    A subprogram stands behind the lines that are executed after it, so the next error may stand
    before. The same error of the same line is another one if it is nearer to the end of the line.
    """
    if error is None or (error.code, error.file, error.line) != (
        repaired.code, repaired.file, repaired.line,
    ):  # fmt: skip
        return True
    return len(error.text) - error.column < len(repaired.text) - repaired.column

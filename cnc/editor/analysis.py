"""Findings of a text while it is typed: the check pass without a plan, and the syntax behind it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from cnc.editor.document import Document
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.lines import events_of_lines
from cnc.gcode.reader.parser import language_of, parse_line
from cnc.gcode.reader.source_text import WINDOW_BYTES, Window, split
from cnc.machine.models import Machine
from cnc.model.choices import TextStyle
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError
from cnc.model.operator_control import Control
from cnc.session.options import RunOptions
from cnc.session.program_reader import InlineProgram, readable_file
from cnc.session.session import Session

_PERCENT = re.compile(rb"(?<![^\r\n])[ \t]*%")
MOST_FURTHER = 100
"""Syntax errors behind the first error that are reported."""


@dataclass(frozen=True)
class Settings:
    """What holds for a program.

    Attributes:
        machine: The machine.
        options: Options of the check.
        style: Form of ``format``.
    """

    machine: Machine
    options: RunOptions
    style: TextStyle = "readable"


@dataclass(frozen=True)
class Analysis:
    """A text that was read.

    Attributes:
        document: The text.
        findings: Errors, warnings and notes.
        rules: Dialect; None if it can't be told.
        assumed: What the reading assumes, for people.
    """

    document: Document
    findings: list[Diagnostic] = field(default_factory=list)
    rules: Dialect | None = None
    assumed: str = ""


def session_of(document: Document, settings: Settings, control: Control | None = None) -> Session:
    """Return a session for a text."""
    program = InlineProgram(document.name, document.data)
    return Session(program, settings.machine, settings.options, control=control)


def analysed(document: Document, settings: Settings, control: Control | None = None) -> Analysis:
    """Read a text as a check does, and return its findings; nothing is planned.

    Args:
        document: The text.
        settings: What holds for it.
        control: A stop ends the reading: the result has what was found until then.
    """
    session = session_of(document, settings, control)
    report = session.read()
    if not document.text.strip():
        return Analysis(document)
    rules = rules_of(session)
    findings = [finding for finding in report.findings if finding.file in ("", document.name)]
    for finding in report.findings:
        if finding.file not in ("", document.name):
            findings.append(_of_other_file(finding))
    errors = [finding for finding in findings if finding.severity == "error"]
    if rules is not None and errors and report.stopped_at_line is None:
        findings += further_errors(document, rules, max(finding.line for finding in errors))
    return Analysis(document, findings, rules, report.assumed)


def rules_of(session: Session) -> Dialect | None:
    """Return the dialect of a program that was read; None if it can't be told."""
    try:
        return session.rules()
    except CncError:
        return None


def dialect_of(document: Document, settings: Settings) -> Dialect | None:
    """Return the dialect of a text by its first lines; None if it can't be told."""
    head, size = [], 0
    for piece in document.pieces:
        head.append(piece)
        size += len(piece)
        if size > WINDOW_BYTES:
            break
    begin = Document(document.name, [*head, ""])
    program = InlineProgram(begin.name, begin.data)
    session = Session(program, settings.machine, settings.options)
    with readable_file(program) as path:
        session.read_from(path)
        return rules_of(session)


def _of_other_file(finding: Diagnostic) -> Diagnostic:
    """Return a finding of a subprogram's file as one of the whole text."""
    message = f"{finding.location()}: {finding.message}"
    return replace(finding, message=message, line=0, column=0, text="", fix=None)


def further_errors(document: Document, rules: Dialect, line: int) -> Iterator[Diagnostic]:
    """Yield the syntax errors behind a line, up to the % that ends a program.

    The check ends at the first error, but the syntax of a line does not depend on other lines.
    """
    if rules.flavour == "klartext":
        return  # blocks have several lines
    syntax, count = rules.syntax(), 0
    for window in windows(document, rules, line + 1):
        reading = events_of_lines(window.data, *window.places, language_of(rules.flavour))
        tape_end = window.find(_PERCENT, 0, window.count)
        for index in np.flatnonzero(reading.results.status).tolist():
            number, text = window.first + index, window.text(index)
            if index > tape_end or count >= MOST_FURTHER:
                return
            try:
                parse_line(text, syntax)
            except GcodeError as error:
                count += 1
                yield replace(error.diagnostic, file=document.name, line=number, text=text)
        if tape_end < window.count:
            return


def windows(
    document: Document, rules: Dialect, first: int, last: int = 1 << 62
) -> Iterator[Window]:
    """Yield windows of lines of a text, in the language of its dialect.

    Args:
        document: The text.
        rules: Its dialect.
        first: First line.
        last: Last line.
    """
    last, size = min(last, document.count), 4096
    for begin in range(first, last + 1, size):
        data = "".join(document.pieces[begin - 1 : min(begin + size - 1, last)]).encode(
            errors="replace"
        )
        yield Window(begin, data, split(data, whole=True)).read_as(language_of(rules.flavour))

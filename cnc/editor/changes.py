"""Changes that an editor offers: repairs of findings, and the form of ``cncrun format``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from cnc.editor.analysis import Analysis, Settings
from cnc.editor.document import Document, TextEdit
from cnc.model.diagnostics import Diagnostic
from cnc.session.program_reader import InlineProgram
from cnc.session.repairs import repaired
from cnc.session.rewriting import in_form


class Repair(NamedTuple):
    """A repair of a finding, as edits of the text."""

    finding: Diagnostic
    title: str
    safe: bool
    edits: list[TextEdit]


def repairs(analysis: Analysis, first: int, last: int) -> Iterator[Repair]:
    """Yield the repairs of the findings in lines ``first`` to ``last``."""
    for finding in analysis.findings:
        if finding.fix is not None and first <= finding.line <= last:
            yield Repair(
                finding,
                finding.fix.title,
                finding.fix.safe,
                [
                    TextEdit(
                        edit.line or finding.line, edit.column - 1,
                        edit.line or finding.line, edit.column - 1 + edit.length, edit.text,
                    )
                    for edit in finding.fix.edits
                ],
            )  # fmt: skip


def all_repaired(document: Document, settings: Settings) -> list[TextEdit]:
    """Return the edits of all safe repairs. They are proved, as ``cncrun check --fix`` does."""
    result = repaired(
        document.name, document.data, settings.machine, settings.options, unsafe=False
    )
    return changed_lines(document, result.new)


def in_style(document: Document, settings: Settings) -> list[TextEdit]:
    """Return the edits that give a text its form; it keeps its blocks.

    Raises:
        CncError: The text has a fault, or would move the machine otherwise.
    """
    program = InlineProgram(document.name, document.data)
    dialect = settings.options.dialect
    with in_form(program, settings.machine, dialect, settings.style) as result:
        return changed_lines(document, result.file.read()) if result.changed else []


def changed_lines(document: Document, new: bytes) -> list[TextEdit]:
    """Return edits of the lines that differ in a new text; it has as many lines."""
    other = Document.of("", new.decode(errors="surrogatepass"))
    if other.count != document.count:
        last = document.count
        return [TextEdit(1, 0, last, len(document.line(last)), other.text)]
    return [
        TextEdit(number, 0, number, len(document.line(number)), other.line(number))
        for number in range(1, document.count + 1)
        if other.line(number) != document.line(number)
    ]

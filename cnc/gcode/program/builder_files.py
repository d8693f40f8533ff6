"""Builder's M-codes that execute a file: ``M31 = { file = "m31.ngc" }`` in the machine file."""

from __future__ import annotations

from collections.abc import Mapping

from cnc.gcode.codes.builder_codes import file_of
from cnc.gcode.program.call_stack import Flow, Frame
from cnc.gcode.program.line_index import Place
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import Word, fault
from cnc.machine.program_codes import CodeAction, RunFile


class FileCall:
    """A line with such a code: its other words are executed, then the lines of the file."""

    __slots__ = ("at", "code", "file", "rest")

    def __init__(self, line: int, statement: Statement, code: Word, file: RunFile) -> None:
        self.at = Place(line, code.column, code.length)
        self.code = code
        self.file = file.file
        computed = dict(statement.computed)
        kept = [index for index, word in enumerate(statement.words) if word is not code]
        self.rest = Statement(
            tuple(statement.words[index] for index in kept),
            tuple((at, computed[index]) for at, index in enumerate(kept) if index in computed),
            statement.assignments,
            statement.remarks,
        )

    def run(self, flow: Flow, line: int) -> int:
        """Execute the rest of the line, then enter the file."""
        flow.interpreter.begun = True
        if self.rest != Statement():
            flow.interpreter.execute(self.rest, line)
        if any(frame.listing.name == str(self.file) for frame in (flow.frame, *flow.frames)):
            message = f"{self.code.written} is in the file that it executes, {self.file}"
            raise flow.listing.placed(fault("call-too-deep", message, self.code), line)
        listing = flow.library.open(self.file, self.at)
        frame = Frame("program", self.code.written, listing, 0, flow.listing, self.at, line + 1)
        frame.ends_with_file = True
        return flow.enter(frame)


def file_call(line: int, statement: Statement, codes: Mapping[int, CodeAction]) -> FileCall | None:
    """Return the step of a line with a code that executes a file; None for another line."""
    for word in statement.words:
        if word.letter == "M" and word.number == word.number:
            file = file_of(codes.get(int(word.number)))
            if file is not None and word.number.is_integer():
                return FileCall(line, statement, word, file)
    return None

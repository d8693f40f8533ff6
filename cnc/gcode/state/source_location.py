"""Where in the text the interpreter is: blocks, warnings and errors that point back at a line ask
here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cnc.gcode.syntax.words import Word
from cnc.model.diagnostics import Diagnostic

Warn = Callable[[Diagnostic], None]


@dataclass(slots=True)
class SourceLocation:
    """The file, the line (from 1) and, for a line of that file, its text and its words."""

    file: str
    warn: Warn | None
    line: int = 0
    text_of: Callable[[int], str] = lambda line: ""
    words_of: Callable[[int], tuple[Word, ...]] = lambda line: ()

    @property
    def text(self) -> str:
        """The source of the line."""
        return self.text_of(self.line)

    def report_warning(self, code: str, message: str, word: Word, hint: str = "") -> None:
        """Say what is legal but odd."""
        if self.warn:
            self.warn(
                Diagnostic(
                    code,
                    message,
                    self.file,
                    self.line,
                    word.column,
                    word.length,
                    self.text,
                    hint,
                    severity="warning",
                )
            )

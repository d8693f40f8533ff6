"""Place of the current line in the program text, for blocks, warnings and errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cnc.gcode.syntax.words import Word
from cnc.model.diagnostics import Diagnostic

Warn = Callable[[Diagnostic], None]


@dataclass(slots=True)
class SourceLocation:
    """The file, the line (from 1), and access to the text and the words of a line."""

    file: str
    warn: Warn | None
    line: int = 0
    text_of: Callable[[int], str] = lambda line: ""
    words_of: Callable[[int], tuple[Word, ...]] = lambda line: ()

    @property
    def text(self) -> str:
        """The text of the line."""
        return self.text_of(self.line)

    def report_warning(self, code: str, message: str, word: Word, hint: str = "") -> None:
        """Report a legal but unusual word of the line."""
        if self.warn:
            self.warn(Diagnostic(code, message, *self._place(word), hint, severity="warning"))

    def report_note(self, code: str, message: str, word: Word, hint: str = "") -> None:
        """Report a word that does no harm and has no effect."""
        if self.warn:
            self.warn(Diagnostic(code, message, *self._place(word), hint, severity="note"))

    def _place(self, word: Word) -> tuple[str, int, int, int, str]:
        """Return file, line, column and length of a word, and the text of its line."""
        return self.file, self.line, word.column, word.length, self.text

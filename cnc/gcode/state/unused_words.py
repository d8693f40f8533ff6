"""F, S and T words that nothing has used yet: one that is replaced first, or that the program ends
before, has no effect.
"""

from __future__ import annotations

from typing import NamedTuple

from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.words import Word
from cnc.model.diagnostics import Diagnostic

_USE = {"F": "a feed move", "S": "a start of the spindle", "T": "a tool change (M6)"}
"""What uses a word of each letter."""


class _Given(NamedTuple):
    file: str
    line: int
    text: str
    word: Word


class UnusedWords:
    """The words that wait to be used; ``words`` by their letters. Nobody keeps books where nobody
    wants to be told.
    """

    def __init__(self, here: SourceLocation) -> None:
        self.words: dict[str, _Given] = {}
        self._here = here
        self.enabled = here.warn is not None

    def note(self, word: Word, line: int | None = None, text: str | None = None) -> None:
        """A word that sets F, S or T, in the line being executed if no other is named."""
        if not self.enabled:
            return
        here = self._here
        at = here.line if line is None else line
        before = self.words.get(word.letter)
        if before is not None:
            if before.word.number == word.number:
                return
            if (before.file, before.line) != (here.file, at):
                message = f"{before.word.written} has no effect: {word.written} in line {at} replaces it before {_USE[word.letter]}"
                self._tell(
                    "word-shadowed",
                    before,
                    message,
                    "take out one of the two, or write what was to happen between them",
                )
        self.words[word.letter] = _Given(here.file, at, here.text if text is None else text, word)

    def mark_used(self, letter: str) -> None:
        """The word of this letter has done something."""
        self.words.pop(letter, None)

    def end(self) -> None:
        """The program is over. A tool that waits is the next program's first."""
        for letter in "FS":
            if given := self.words.pop(letter, None):
                message = (
                    f"{given.word.written} has no effect: the program ends before {_USE[letter]}"
                )
                self._tell("word-without-effect", given, message, "take it out")

    def _tell(self, code: str, given: _Given, message: str, hint: str) -> None:
        assert self._here.warn is not None
        word = given.word
        self._here.warn(
            Diagnostic(
                code,
                message,
                given.file,
                given.line,
                word.column,
                word.length,
                given.text,
                hint,
                severity="note",
            )
        )

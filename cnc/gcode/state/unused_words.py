"""Notes on F, S and T words without effect.

A word has no effect if another one replaces it, or the program ends, before a move or a code uses
it.
"""

from __future__ import annotations

from typing import NamedTuple

from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.words import Word
from cnc.model.diagnostics import Diagnostic

_USE = {"F": "a feed move", "S": "a start of the spindle", "T": "a tool change (M6)"}
"""The use of the word of each letter."""


class _Given(NamedTuple):
    file: str
    line: int
    text: str
    word: Word


class UnusedWords:
    """The unused words by letter. Nothing is recorded without a receiver of warnings."""

    def __init__(self, here: SourceLocation) -> None:
        self.words: dict[str, _Given] = {}
        self._here = here
        self.enabled = here.warn is not None

    def note(self, word: Word, line: int | None = None, text: str | None = None) -> None:
        """Record a word that sets F, S or T, in the current line if no other is given."""
        if not self.enabled:
            return
        here = self._here
        at = here.line if line is None else line
        before = self.words.get(word.letter)
        if before is not None:
            if before.word.number == word.number:
                return
            if (before.file, before.line) != (here.file, at):
                message = (
                    f"{before.word.written} has no effect: {word.written} in line {at} replaces it "
                    f"before {_USE[word.letter]}"
                )
                self._report(
                    "word-shadowed",
                    before,
                    message,
                    "remove one of the two words, or insert the code that uses the first",
                )
        self.words[word.letter] = _Given(here.file, at, here.text if text is None else text, word)

    def mark_used(self, letter: str) -> None:
        """Remove the word of a letter, which has been used."""
        self.words.pop(letter, None)

    def end(self) -> None:
        """Report the unused words at the program end. A T word may be for the next program."""
        for letter in "FS":
            if given := self.words.pop(letter, None):
                message = (
                    f"{given.word.written} has no effect: the program ends before {_USE[letter]}"
                )
                self._report("word-without-effect", given, message, "remove it")

    def _report(self, code: str, given: _Given, message: str, hint: str) -> None:
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

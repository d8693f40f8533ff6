"""Diagnostics: what is wrong, where, and what to do.

Every fault that a user can cause or meet is a :class:`Diagnostic`; the exceptions below carry one
each and name the exit code that the command line ends with. No other exception may reach a user.

    trident.nc:4:12: arc-radius-mismatch: the end point is 1.5 mm off the circle
      G2 X10 Y0 I5 J1.5
                ^~
      help: give I and J from the start point to the centre
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
"""The gravest first."""

SHOWN_CHARACTERS = 160
"""Characters of a source line that a message shows."""

EXIT_REJECTED = 1
EXIT_USAGE = 2
EXIT_BOARD = 3
EXIT_STOPPED = 130


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One finding.

    ``line`` and ``column`` count from 1; 0 means that the finding has no such place. ``length`` is
    the number of characters that the caret underlines, ``text`` the source line, ``hint`` what to
    do.
    """

    code: str
    message: str
    file: str = ""
    line: int = 0
    column: int = 0
    length: int = 1
    text: str = ""
    hint: str = ""
    severity: Severity = "error"

    def location(self) -> str:
        """``file:line:column``, as far as each is known."""
        parts = [self.file] if self.file else []
        if self.line:
            parts.append(str(self.line))
            if self.column:
                parts.append(str(self.column))
        return ":".join(parts)

    def render(self) -> str:
        """The message as a user sees it: place, code, text, then the source line with a caret, then
        the hint.
        """
        place = self.location()
        lines = [
            f"{place}: {self.code}: {self.message}" if place else f"{self.code}: {self.message}"
        ]
        if self.text:
            # Of a long line only what stands about the place.
            first = (
                max(0, self.column - SHOWN_CHARACTERS // 2)
                if len(self.text) > SHOWN_CHARACTERS
                else 0
            )
            shown = "".join(
                c if c.isprintable() else " " for c in self.text[first : first + SHOWN_CHARACTERS]
            )
            lines.append(f"  {shown}")
            if self.column:
                marked = min(
                    max(self.length, 1), max(first + SHOWN_CHARACTERS - self.column + 1, 1)
                )
                lines.append("  " + " " * (self.column - 1 - first) + "^" + "~" * (marked - 1))
        if self.hint:
            lines.append(f"  help: {self.hint}")
        return "\n".join(lines)


class CncError(Exception):
    """A fault with a diagnostic; the subclass says who has to mend it."""

    exit_code = EXIT_REJECTED

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(diagnostic.render())
        self.diagnostic = diagnostic

    def __reduce__(self) -> tuple[type[CncError], tuple[Diagnostic]]:
        """A fault goes from one process to another with its diagnostic, not with the text of it
        alone.
        """
        return type(self), (self.diagnostic,)

    def at(
        self, *, file: str | None = None, line: int | None = None, text: str | None = None
    ) -> CncError:
        """The same fault, its place filled in by a caller that knows it."""
        known = self.diagnostic
        return type(self)(
            replace(
                known,
                file=known.file if file is None else file,
                line=known.line if line is None else line,
                text=known.text if text is None else text,
            )
        )


class GcodeError(CncError):
    """The program is not what the dialect allows."""


class MotionLimitError(CncError):
    """The program asks for motion that the machine must not make."""


class UsageError(CncError):
    """The command line asks for something that can't be."""

    exit_code = EXIT_USAGE


class MachineFileError(CncError):
    """The machine file is wrong; the message names file and key."""

    exit_code = EXIT_USAGE


class BoardError(CncError):
    """The board or the link failed, or the board raised an alarm."""

    exit_code = EXIT_BOARD

"""Diagnostics: messages with a code, a source location and a hint.

Every fault that a user can cause or meet is a :class:`Diagnostic`. Each exception below carries one
and names the exit code of the command line. No other exception may reach a user.

    trident.nc:4:12: arc-radius-mismatch: the end point is 1.5 mm off the circle
      G2 X10 Y0 I5 J1.5
                ^~
      help: give I and J from the start point to the centre
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

# Text from outside, such as names of files, shown so that it controls nothing.
#
# A terminal obeys control characters. The runner of GitHub obeys lines that begin with ``::``, and
# ``##[`` anywhere in a line (actions/runner, ``ActionCommand.cs``).


def printable(text: str) -> str:
    """Return text on one line whose control characters are escapes."""
    if not text.isprintable():
        text = "".join(
            character if character.isprintable() else character.encode("unicode_escape").decode()
            for character in text
        )
    return text.replace("##[", "#\\x23[")


def shown_name(name: str) -> str:
    """Return the name of a file for the beginning of a line."""
    text = printable(name)
    return f"'{text}'" if text.lstrip().startswith(":") else text


def shown_json(text: str) -> str:
    """Return the same JSON without a command of the runner; ``##[`` occurs in strings alone."""
    return text.replace("##[", "#\\u0023[")


Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
"""In decreasing order of severity."""

SHOWN_CHARACTERS = 160
"""Characters of a source line that a message shows."""

EXIT_REJECTED = 1
EXIT_USAGE = 2
EXIT_BOARD = 3
EXIT_STOPPED = 130


class Edit(NamedTuple):
    """A replacement in a line of the program.

    Attributes:
        column: First character that is replaced, from 1.
        length: Number of characters; 0 inserts.
        text: Text in their place. A line end in it adds a line.
        line: Line from 1; 0 for the line of the finding.
    """

    column: int
    length: int
    text: str
    line: int = 0


@dataclass(frozen=True, slots=True)
class Fix:
    """The one right repair of a finding.

    Attributes:
        title: What it does, for people.
        edits: Replacements that belong together.
        safe: Whether the program keeps its blocks, and no text of the author is lost.
    """

    title: str
    edits: tuple[Edit, ...]
    safe: bool = False

    @classmethod
    def replace(
        cls, title: str, column: int, length: int, text: str = "", *, safe: bool = False
    ) -> Fix:
        """Return a repair with one edit in the line of the finding."""
        return cls(title, (Edit(column, length, text),), safe)


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One finding. Control characters in the message and the hint become escapes.

    Attributes:
        code: Public code, such as ``soft-limit``.
        message: The problem, in the machinist's terms.
        file: Program or machine file; empty if the finding has none.
        line: Line from 1; 0 if the finding has none.
        column: Column from 1; 0 if the finding has none.
        length: Number of characters that the caret underlines.
        text: Source line.
        hint: The remedy.
        severity: Severity.
        fix: The repair; None where there is none, or more than one.
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
    fix: Fix | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "message", printable(self.message))
        object.__setattr__(self, "hint", "\n".join(map(printable, self.hint.split("\n"))))

    def location(self) -> str:
        """Return ``file:line:column``, as far as each is known."""
        parts = [shown_name(self.file)] if self.file else []
        if self.line:
            parts.append(str(self.line))
            if self.column:
                parts.append(str(self.column))
        return ":".join(parts)

    def render(self) -> str:
        """Return the message as a user sees it.

        It has the location, the code and the message, then the source line with a caret, then the
        hint.
        """
        location = self.location()
        lines = [
            f"{location}: {self.code}: {self.message}"
            if location
            else f"{self.code}: {self.message}"
        ]
        if self.text:
            # A long line is cut to the characters around the column.
            first = (
                max(0, self.column - SHOWN_CHARACTERS // 2)
                if len(self.text) > SHOWN_CHARACTERS
                else 0
            )
            shown = "".join(
                c if c.isprintable() else " " for c in self.text[first : first + SHOWN_CHARACTERS]
            )
            # As in cnc.model.diagnostics, but each character keeps its column.
            shown = re.sub(r"^\s*:+(?=:)", lambda match: " " * len(match[0]), shown)
            lines.append("  " + shown.replace("##[", "# ["))
            if self.column:
                marked = min(
                    max(self.length, 1), max(first + SHOWN_CHARACTERS - self.column + 1, 1)
                )
                lines.append("  " + " " * (self.column - 1 - first) + "^" + "~" * (marked - 1))
        if self.hint:
            lines.append(f"  help: {printable(self.hint)}")
        return "\n".join(lines)


class CncError(Exception):
    """A fault with a diagnostic. The subclass tells where the cause is."""

    exit_code = EXIT_REJECTED

    def __init__(self, diagnostic: Diagnostic) -> None:
        super().__init__(diagnostic.render())
        self.diagnostic = diagnostic

    def __reduce__(self) -> tuple[type[CncError], tuple[Diagnostic]]:
        """Pickle the diagnostic itself, so that worker processes can send faults back."""
        return type(self), (self.diagnostic,)

    def at(
        self, *, file: str | None = None, line: int | None = None, text: str | None = None
    ) -> CncError:
        """Return the same fault with parts of its location replaced.

        Args:
            file: New file, or None to keep the known one.
            line: New line, or None to keep the known one.
            text: New source line, or None to keep the known one.
        """
        finding = self.diagnostic
        return type(self)(
            replace(
                finding,
                file=finding.file if file is None else file,
                line=finding.line if line is None else line,
                text=finding.text if text is None else text,
            )
        )


class GcodeError(CncError):
    """The program violates the rules of its dialect."""


class MotionLimitError(CncError):
    """The program requests motion beyond the limits of the machine."""


class UsageError(CncError):
    """The command line requests something impossible."""

    exit_code = EXIT_USAGE


class MachineFileError(CncError):
    """The machine file has an error; the message names file and key."""

    exit_code = EXIT_USAGE


class BoardError(CncError):
    """The board or its connection failed, or the board raised an alarm."""

    exit_code = EXIT_BOARD


def write_error(path: object, error: OSError) -> UsageError:
    """Return the fault ``can-not-write`` of an output file."""
    return UsageError(
        Diagnostic(
            "can-not-write",
            f"{'standard output' if path == '-' else path} cannot be written: "
            f"{error.strerror or error}",
            hint="choose a file in a folder that you may write to",
        )
    )

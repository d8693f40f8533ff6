"""The file that a program is read from, and the source lines that messages show."""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import IO

from cnc.gcode.syntax.source_text import Text
from cnc.model.diagnostics import CncError, Diagnostic, UsageError

STANDARD_INPUT = "-"
STANDARD_INPUT_NAME = "<stdin>"
"""Name of standard input in messages."""
MDI_NAME = "MDI"
"""Name of a line that the operator has entered, in messages."""
WITHOUT_FILE = (STANDARD_INPUT_NAME, MDI_NAME)
"""Names of programs that have no file: no checkpoint, and no folder of subroutines."""
COPIED_BYTES = 4_000_000
"""A longer file is copied before it is read, so that the checked program is the one that runs.

The text of a shorter file stays in memory between the passes.
"""


@dataclass(frozen=True, slots=True)
class InlineProgram:
    """A program together with its text, for a computer that does not have the file."""

    name: str
    text: bytes

    def __str__(self) -> str:
        return self.name


Source = Path | str | InlineProgram
"""A program's file, ``-`` for standard input, or the program itself."""


def display_name(program: Source) -> str:
    """Return the name of the program in messages."""
    return STANDARD_INPUT_NAME if str(program) == STANDARD_INPUT else str(program)


@contextmanager
def readable_file(program: Source) -> Iterator[Path]:
    """Provide a file that can be read twice and does not change between the passes.

    Standard input (``-``), pipes and long files are copied to the system's temporary folder.

    Raises:
        UsageError: ``no-such-file``, ``is-a-folder``, ``can-not-read``.
    """
    path = Path(str(program))
    with ExitStack() as stack:
        try:
            if isinstance(program, InlineProgram):
                path = _copy(BytesIO(program.text), stack)
            elif str(program) == STANDARD_INPUT:
                path = _copy(sys.stdin.buffer, stack)
            elif path.is_dir():
                hint = "name a program file; cncrun check accepts folders"
                raise UsageError(Diagnostic("is-a-folder", f"{program} is a folder", hint=hint))
            elif not path.is_file() or path.stat().st_size > COPIED_BYTES:
                path = _copy(stack.enter_context(path.open("rb")), stack)
        except FileNotFoundError as error:
            hint = "check the name and the folder"
            raise UsageError(
                Diagnostic("no-such-file", f"there is no file {program}", hint=hint)
            ) from error
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise UsageError(
                Diagnostic("can-not-read", f"{program} cannot be read: {reason}")
            ) from error
        yield path


def _copy(source: IO[bytes], stack: ExitStack) -> Path:
    """Copy to a temporary file that is removed when ``stack`` closes."""
    copy = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cnc-"))) / "program.nc"
    with copy.open("wb") as target:
        shutil.copyfileobj(source, target)
    return copy


def with_source_lines(faults: Sequence[CncError], paths: Mapping[str, Path]) -> list[CncError]:
    """Add the source line, and the column of the word concerned, to faults that lack them.

    Args:
        faults: The faults, in order.
        paths: Files whose name in messages is not their path.

    Returns:
        The faults in the same order.
    """
    texts: dict[str, Text] = {}
    completed: list[CncError] = []
    for fault in faults:
        found = fault.diagnostic
        path = paths.get(found.file, Path(found.file))
        if found.line and not found.text and path.is_file():
            text = texts.setdefault(found.file, Text.of_file(path))
            window = text.window(found.line)
            if window:
                fault = _with_source_line(fault, window.text(found.line - window.first))
        completed.append(fault)
    return completed


def _with_source_line(fault: CncError, text: str) -> CncError:
    found = fault.diagnostic
    code = re.sub(r"\([^()]*\)|;.*", lambda comment: " " * len(comment[0]), text)
    if found.text or not code.strip():
        return fault
    axis = re.match(r"[A-Z](?= would reach )", found.message)
    letter = axis[0] if axis else "F" if found.code == "feed-unreachable" else ""
    word = (letter and re.search(rf"{letter}\s*[-+]?[\d.]+", code, re.IGNORECASE)) or re.search(
        r"\S(?:.*\S)?", code
    )
    column, length = found.column, found.length
    if word and not column:
        column, length = word.start() + 1, len(word[0])
    return type(fault)(replace(found, text=text, column=column, length=length))

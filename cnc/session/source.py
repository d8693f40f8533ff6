"""The file that a program is read from, and the lines of it that a message shows."""

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
"""How messages call it."""
COPIED_BYTES = 4_000_000
"""A file longer than this is copied before it is read twice, so that what was checked is what
runs.
"""


@dataclass(frozen=True, slots=True)
class Shipped:
    """A program that comes with its text: the file of this name may be on another computer."""

    name: str
    text: bytes

    def __str__(self) -> str:
        return self.name


Source = Path | str | Shipped
"""A program's file, ``-`` for standard input, or the program itself."""


def shown_name(program: Source) -> str:
    """How messages call the program."""
    return STANDARD_INPUT_NAME if str(program) == STANDARD_INPUT else str(program)


@contextmanager
def readable(program: Source) -> Iterator[Path]:
    """A file that can be read twice and does not change meanwhile: short ones are kept in memory
    between the passes, others are copied.

    Standard input (``-``), pipes and long files are copied to the system's temporary folder.
    UsageError ``no-such-file``, ``is-a-folder``, ``can-not-read``.
    """
    path = Path(str(program))
    with ExitStack() as stack:
        try:
            if isinstance(program, Shipped):
                path = _copy(BytesIO(program.text), stack)
            elif str(program) == STANDARD_INPUT:
                path = _copy(sys.stdin.buffer, stack)
            elif path.is_dir():
                raise UsageError(
                    Diagnostic(
                        "is-a-folder",
                        f"{program} is a folder",
                        hint="name a program; cncrun check takes folders",
                    )
                )
            elif not path.is_file() or path.stat().st_size > COPIED_BYTES:
                path = _copy(stack.enter_context(path.open("rb")), stack)
        except FileNotFoundError as error:
            raise UsageError(
                Diagnostic(
                    "no-such-file",
                    f"there is no file {program}",
                    hint="check the name and the folder",
                )
            ) from error
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise UsageError(
                Diagnostic("can-not-read", f"{program} can't be read: {reason}")
            ) from error
        yield path


def _copy(source: IO[bytes], stack: ExitStack) -> Path:
    """A copy that lasts as long as ``stack``."""
    copy = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="cnc-"))) / "program.nc"
    with copy.open("wb") as target:
        shutil.copyfileobj(source, target)
    return copy


def with_texts(faults: Sequence[CncError], paths: Mapping[str, Path]) -> list[CncError]:
    """The same faults; those that name a line and don't show it get its text, and a column: that of
    the axis they speak of, if any.

    ``paths``: the files that go by another name; the others are found by their own.
    """
    texts: dict[str, Text] = {}
    mended: list[CncError] = []
    for fault in faults:
        found = fault.diagnostic
        path = paths.get(found.file, Path(found.file))
        if found.line and not found.text and path.is_file():
            text = texts.setdefault(found.file, Text.of_file(path))
            window = text.window(found.line)
            fault = _with_text(fault, window.text(found.line - window.first)) if window else fault
        mended.append(fault)
    return mended


def _with_text(fault: CncError, text: str) -> CncError:
    found = fault.diagnostic
    code = re.sub(r"\([^()]*\)|;.*", lambda comment: " " * len(comment[0]), text)
    if found.text or not code.strip():
        return fault
    letter = (
        found.message[0]
        if found.code == "soft-limit"
        else "F"
        if found.code == "feed-unreachable"
        else ""
    )
    word = (letter and re.search(rf"{letter}\s*[-+]?[\d.]+", code, re.IGNORECASE)) or re.search(
        r"\S(?:.*\S)?", code
    )
    column, length = (
        (word.start() + 1, len(word[0]))
        if word and not found.column
        else (found.column, found.length)
    )
    return type(fault)(replace(found, text=text, column=column, length=length))

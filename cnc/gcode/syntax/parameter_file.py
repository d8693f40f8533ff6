"""The parameter file: numbers and values of the parameters that stay between programs.

Source: LinuxCNC, "Parameters", the parameter file.
"""

from __future__ import annotations

import math
import os
import re
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from cnc.gcode.syntax.parameters import LAST_MACRO, MORE_MACRO
from cnc.model.diagnostics import Diagnostic, UsageError

_LINE = re.compile(r"\s*([0-9]+)\s+([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*")


def read_parameters(path: str | os.PathLike[str]) -> dict[int, float]:
    """Read a parameter file: a number and its value in each line, by ascending number.

    Raises:
        UsageError: ``no-such-file``, ``unreadable-file``, ``parameter-file-line``,
            ``parameter-file-order``, with file and line.
    """
    name = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="latin-1")
    except FileNotFoundError:
        hint = "to begin with, make an empty file of this name"
        raise UsageError(
            Diagnostic("no-such-file", f"there is no parameter file {name}", file=name, hint=hint)
        ) from None
    except OSError as error:
        raise UsageError(
            Diagnostic(
                "unreadable-file",
                f"cannot read the parameter file {name}: {error.strerror}",
                file=name,
            )
        ) from None
    values: dict[int, float] = {}
    last = 0
    for line, raw in enumerate(text.split("\n"), start=1):
        if not raw.strip():
            continue
        found = _LINE.fullmatch(raw)
        value = float(found[2]) if found else math.inf
        if found is None or not math.isfinite(value):
            raise _file_error(
                "parameter-file-line",
                "this is not the number of a parameter and its value",
                name,
                line,
                raw,
                "such as 5221 10.5",
            )
        number = int(found[1])
        if not (1 <= number <= LAST_MACRO or number in MORE_MACRO):
            raise _file_error(
                "parameter-file-line",
                f"there is no parameter {number}",
                name,
                line,
                raw,
                f"parameters are 1 to {LAST_MACRO}, and Haas' {MORE_MACRO[0]} to {MORE_MACRO[-1]}",
            )
        if number <= last:
            message = f"{number} comes after {last}"
            raise _file_error(
                "parameter-file-order",
                message,
                name,
                line,
                raw,
                "numbers must ascend, each given once",
            )
        values[number] = value
        last = number
    return values


def write_parameters(path: str | os.PathLike[str], values: Mapping[int, float]) -> None:
    """Write a parameter file. ``float`` reads each value back exactly.

    The old file is replaced when the new one is complete.

    Raises:
        UsageError: ``unwritable-file``.
    """
    replace_text(
        path,
        "".join(f"{number}\t{value!r}\n" for number, value in sorted(values.items())),
        "the parameter file",
    )


def replace_text(path: str | os.PathLike[str], text: str, name_in_messages: str) -> None:
    """Replace a file by a new one when the new one is complete.

    Args:
        path: The file.
        text: Its new text.
        name_in_messages: The file as messages call it, such as "the tool table".

    Raises:
        UsageError: ``unwritable-file``.
    """
    target = Path(os.path.realpath(path))
    try:
        handle, draft = tempfile.mkstemp(
            prefix=target.name + ".", suffix=".part", dir=target.parent
        )
        try:
            with open(handle, "w", encoding="utf-8", newline="\n") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(draft, _mode(target))
            os.replace(draft, target)
        except BaseException:
            with suppress(OSError):
                os.unlink(draft)
            raise
    except OSError as error:
        name = os.fspath(path)
        raise UsageError(
            Diagnostic(
                "unwritable-file",
                f"cannot write {name_in_messages} {name}: {error.strerror}",
                file=name,
            )
        ) from None


def _mode(target: Path) -> int:
    """Return the permissions of the file that is replaced, or those of a new file."""
    try:
        return target.stat().st_mode & 0o777
    except OSError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask


def _file_error(code: str, message: str, file: str, line: int, text: str, hint: str) -> UsageError:
    shown = text.rstrip()
    return UsageError(
        Diagnostic(
            code,
            message,
            file,
            line,
            len(shown) - len(shown.lstrip()) + 1,
            len(shown.strip()),
            shown,
            hint,
        )
    )

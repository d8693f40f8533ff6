"""Standard input, output and error of a command: closed ones, and an error output that is full."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a write to a full disk, as to a file to which an output is redirected."""


class _ErrorOutput(io.FileIO):
    """Standard error. Messages that a full disk does not take are lost: they must not end a run."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Write some bytes."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in NO_SPACE:
                raise
            return memoryview(data).nbytes


def prepare_streams() -> None:
    """Make standard input, output and error usable, whether they are open, closed or full.

    The number of a closed one would go to the next file, such as the port of a board, which would
    then receive the messages. A closed output takes and drops everything; reading a closed input is
    an error.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None and not _is_open(number):
            os.set_inheritable(os.open(os.devnull, os.O_WRONLY), True)
            file = io.FileIO(number, "w" if number else "r", closefd=False)
            buffer = io.BufferedWriter(file) if number else io.BufferedReader(file)
            setattr(sys, name, io.TextIOWrapper(buffer, encoding="utf-8"))
    # A file name may contain bytes that are not text; printing it must not fail.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    if isinstance(sys.stderr, io.TextIOWrapper):
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(_ErrorOutput(2, "w", closefd=False)),
            encoding=sys.stderr.encoding,
            errors="backslashreplace",
            line_buffering=True,
        )


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True

"""A program written in one form (``cncrun format``), and the proof that its blocks stay the same.

Both texts are read. Nothing is written unless they give the same blocks, to the bit.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import IO, Any, NamedTuple

import numpy as np

from cnc.gcode.reader.layout import formatted
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Polyline
from cnc.model.choices import DialectName, TextStyle
from cnc.model.diagnostics import CncError, Diagnostic, shown_name
from cnc.session.options import RunOptions
from cnc.session.program_reader import (
    Source,
    display_name,
    readable_file,
    with_source_lines,
)
from cnc.session.session import Session


class _Fingerprint:
    """A digest of blocks that does not depend on how moves are divided into runs."""

    def __init__(self) -> None:
        self._columns: dict[str, Any] = {}
        self._moves = 0

    def add(self, blocks: Iterable[Block]) -> None:
        """Add blocks."""
        for block in blocks:
            if isinstance(block, Polyline):
                self._add_moves(block)
            else:
                self._column("other", repr((self._moves, _plain(block))).encode())

    def _add_moves(self, run: Polyline) -> None:
        for name, column in (
            ("points", run.points), ("feeds", run.feeds), ("lines", run.lines),
            ("timed", np.full(len(run.lines), run.timed)),
        ):  # fmt: skip
            self._column(name, np.ascontiguousarray(column).tobytes())
        if run.commands is not None:
            for index, commands in enumerate(run.commands):
                if commands:
                    self._column("other", repr((self._moves + index, _plain(commands))).encode())
        self._moves += len(run.lines)

    def _column(self, name: str, data: bytes) -> None:
        self._columns.setdefault(name, hashlib.blake2b()).update(data)

    def digests(self) -> dict[str, str]:
        """Return the digest of each column."""
        return {name: column.hexdigest() for name, column in self._columns.items()}


_OF_READING = frozenset(("file", "answer"))
"""Fields of blocks that differ from one reading to the next."""


def _plain(value: Any) -> Any:
    """Return a value of a block whose text shows all of it."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if isinstance(value, Block):
        names = (field.name for field in fields(value) if field.name not in _OF_READING)
        return type(value).__name__, [_plain(getattr(value, name)) for name in names]
    return value


def fingerprint(blocks: Iterable[Block]) -> dict[str, str]:
    """Return the digests of blocks by their columns. Raises the faults of the program."""
    digest = _Fingerprint()
    digest.add(blocks)
    return digest.digests()


class Result(NamedTuple):
    """A program in its form.

    Attributes:
        file: the text in its form, at its begin. It is gone when the context ends.
        changed: whether it differs from the program.
    """

    file: IO[bytes]
    changed: bool


@contextmanager
def in_form(
    program: Source, machine: Machine, dialect: DialectName | None, style: TextStyle
) -> Iterator[Result]:
    """Give the text of a program in a style, which gives the same blocks.

    Args:
        program: the file, ``-`` for standard input, or the program itself.
        machine: the machine that the program is for.
        dialect: how to read it; None for the machine file's choice.
        style: the style.

    Raises:
        UsageError: the file cannot be read.
        GcodeError: a fault of the program. A text that cannot be read is not written anew.
        CncError: ``format-differs``: the text would move the machine otherwise.
    """
    # What the program does not say is the same for both texts.
    options = RunOptions(
        dialect=dialect, tool_lengths="zero", unknown_codes="warn", default_feed=60.0
    )
    with readable_file(program) as path, tempfile.NamedTemporaryFile(suffix=path.suffix) as file:
        session = Session(program, machine, options)
        session.read_from(path)
        try:
            before = fingerprint(session.blocks())
        except CncError as error:
            name = display_name(program)
            raise with_source_lines([error], {name: path})[0] from None
        changed = False
        with path.open("rb") as source:
            for part in formatted(path, session.rules(), style):
                changed = changed or source.read(len(part)) != part
                file.write(part)
            changed = changed or source.read(1) != b""
        file.flush()
        if changed and fingerprint(Session(file.name, machine, options).blocks()) != before:
            raise _differs(display_name(program))
        file.seek(0)
        yield Result(file, changed)


def _differs(program: str) -> CncError:
    message = f"{shown_name(program)} would give other blocks in this form, so it is left as it is"
    return CncError(
        Diagnostic("format-differs", message, file=program, hint="send the program with a report")
    )

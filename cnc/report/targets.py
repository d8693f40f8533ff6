"""Targets of output: a file that is replaced as a whole, a device or pipe, or standard output."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from abc import ABC, abstractmethod
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, AnyStr, Generic, Protocol, TypeVar

from numpy.typing import ArrayLike, NDArray

from cnc.model.diagnostics import Diagnostic, UsageError, write_error
from cnc.model.npz import NpzWriter

STANDARD_OUTPUT = "-"

TRACE_SUFFIXES = (".npz", ".csv")
PULSE_SUFFIXES = (".npz", ".vcd")
LINE_SUFFIXES = (".nc", ".gcode")
STL_SUFFIXES = (".stl",)
PICTURE_SUFFIXES = (".html", ".png", ".svg", ".json")


class Output(Protocol):
    """A file that is being written. It appears on ``close``; ``discard`` keeps the old one."""

    def close(self) -> None:
        """Finish the file and put it in place."""

    def discard(self) -> None:
        """Keep the file that was there before. Has no effect after ``close``."""


def suffix_of(option: str, name: str, known: tuple[str, ...]) -> str:
    """Return the suffix that selects an output's format, in lower case.

    Args:
        option: the command-line option, without its dashes.
        name: the file, or ``-`` for standard output, which has the last of ``known``.
        known: the suffixes of the formats that there are.

    Raises:
        UsageError: ``output-format`` for another suffix.
    """
    suffix = known[-1] if name == STANDARD_OUTPUT else Path(name).suffix.lower()
    if suffix not in known:
        raise UsageError(
            Diagnostic(
                "output-format",
                f"--{option} {name}: the suffix selects the format, and this one is unknown",
                hint=f"use a file name that ends in {' or '.join(known)}",
            )
        )
    return suffix


def check_suffixes(trace: str | None, pulses: str | None, lines: str | None) -> None:
    """Raise UsageError ``output-format`` before any work is done; see :func:`suffix_of`."""
    for option, name, known in (
        ("trace", trace, TRACE_SUFFIXES),
        ("pulses", pulses, PULSE_SUFFIXES),
        ("lines", lines, LINE_SUFFIXES),
    ):
        if name is not None:
            suffix_of(option, name, known)


def check_picture(name: str) -> None:
    """Check that a picture can be drawn.

    Raises:
        UsageError: ``output-format`` for an unknown suffix; ``drawing-missing`` without matplotlib.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in PICTURE_SUFFIXES:
        hint = "use out.html for an interactive page, out.png or out.svg for an image"
        raise UsageError(
            Diagnostic(
                "output-format", f"a picture is a .html, .png or .svg file, not {name}", hint=hint
            )
        )
    if suffix in (".png", ".svg") and find_spec("matplotlib") is None:
        message = f"{suffix} needs matplotlib, which is not installed"
        hint = "pip install 'cncrun[view]', or use out.html, which does not need it"
        raise UsageError(Diagnostic("drawing-missing", message, hint=hint))


class FileTarget(ABC, Generic[AnyStr]):
    """Text or bytes for the file ``name``, which is replaced as a whole on :meth:`close`.

    A device or a pipe is written to directly. Every method raises UsageError ``can-not-write``
    when the operating system refuses.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._draft: Path | None = None
        self._stream: IO[AnyStr]
        try:
            if name == STANDARD_OUTPUT:
                self._stream = self._standard_output()
            elif Path(name).exists() and not Path(name).is_file():
                self._stream = self._opened(name)
            else:
                handle, draft = tempfile.mkstemp(
                    prefix=Path(name).name + ".", suffix=".part", dir=Path(name).parent
                )
                self._draft = Path(draft)
                self._stream = self._opened(handle)
        except OSError as error:
            raise write_error(name, error) from error

    @abstractmethod
    def _standard_output(self) -> IO[AnyStr]:
        """Return standard output."""

    @abstractmethod
    def _opened(self, file: int | str) -> IO[AnyStr]:
        """Open a file name or a descriptor for writing."""

    def write(self, content: AnyStr) -> None:
        """Append ``content``."""
        try:
            self._stream.write(content)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise write_error(self.name, error) from error

    def close(self) -> None:
        """Put the file in place."""
        try:
            self._stream.flush()
            if self.name != STANDARD_OUTPUT:
                self._stream.close()
            if self._draft is not None:
                self._draft.chmod(0o666 & ~_umask())
                self._draft.replace(self.name)
                self._draft = None
        except BrokenPipeError:
            raise
        except OSError as error:
            raise write_error(self.name, error) from error

    def discard(self) -> None:
        """Keep the file that was there before. Has no effect after :meth:`close`."""
        if self.name != STANDARD_OUTPUT:
            # The buffered rest may not fit on the disk; it is thrown away in any case.
            with contextlib.suppress(OSError):
                self._stream.close()
        if self._draft is not None:
            self._draft.unlink(missing_ok=True)
            self._draft = None


class TextTarget(FileTarget[str]):
    """Text, written as UTF-8."""

    def _standard_output(self) -> IO[str]:
        return sys.stdout

    def _opened(self, file: int | str) -> IO[str]:
        return open(file, "w", encoding="utf-8", newline="\n")


class BytesTarget(FileTarget[bytes]):
    """Bytes, written unchanged."""

    def _standard_output(self) -> IO[bytes]:
        return sys.stdout.buffer

    def _opened(self, file: int | str) -> IO[bytes]:
        return open(file, "wb")


class NpzTarget:
    """An .npz archive for the file ``name``, which is replaced as a whole on :meth:`close`.

    A device or a pipe receives the finished archive at the end.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        path = Path(name)
        try:
            if path.exists() and not path.is_file():
                if path.is_dir():
                    raise IsADirectoryError(0, "it is a folder")
                self._folder = tempfile.TemporaryDirectory(prefix="cnc-")
                path = Path(self._folder.name) / "out.npz"
            self._writer = NpzWriter(path)
        except OSError as error:
            raise write_error(name, error) from error

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Append ``rows`` to the array ``name``."""
        try:
            self._writer.append(name, rows)
        except OSError as error:
            raise write_error(self.name, error) from error

    def scalar(self, name: str, value: ArrayLike) -> None:
        """Store a number, a text or a short array under ``name``."""
        self._writer.scalar(name, value)

    def close(self) -> None:
        """Put the archive in place."""
        try:
            self._writer.close()
            if self._folder is not None:
                with open(self._writer.path, "rb") as source, open(self.name, "wb") as target:
                    shutil.copyfileobj(source, target)
                self._folder.cleanup()
        except OSError as error:
            raise write_error(self.name, error) from error

    def discard(self) -> None:
        """Keep the file that was there before. Has no effect after :meth:`close`."""
        self._writer.discard()
        if self._folder is not None:
            self._folder.cleanup()


TargetT = TypeVar("TargetT", bound=Output)


class Writer(Generic[TargetT]):
    """Base of the writers of one format. Each owns a target and closes or discards it."""

    def __init__(self, target: TargetT) -> None:
        self._target = target

    def close(self) -> None:
        """Finish the file and put it in place."""
        self._target.close()

    def discard(self) -> None:
        """Keep the file that was there before. Has no effect after ``close``."""
        self._target.discard()


def _umask() -> int:
    """Return the file mode mask of the process, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask

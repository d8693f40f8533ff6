"""Where output goes: a file that appears whole or not at all, a device or pipe, or standard
output.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import IO, Any, AnyStr, Generic

from numpy.typing import ArrayLike, NDArray

from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.npz import NpzWriter

STANDARD_OUTPUT = "-"


def can_not_write(path: object, error: OSError) -> UsageError:
    """The fault of an output that can't be written."""
    return UsageError(
        Diagnostic(
            "can-not-write",
            f"{path} can't be written: {error.strerror or error}",
            hint="name a file in a folder that you can write to",
        )
    )


class FileTarget(Generic[AnyStr]):
    """Text or bytes on their way to ``name``: an ordinary file is replaced as a whole on
    :meth:`close`.

    What is no ordinary file (a device, a pipe) is written to directly. Raises UsageError
    ``can-not-write``.
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
            raise can_not_write(name, error) from error

    def _standard_output(self) -> IO[AnyStr]:
        raise NotImplementedError

    def _opened(self, file: int | str) -> IO[AnyStr]:
        raise NotImplementedError

    def write(self, content: AnyStr) -> None:
        """Add ``content``."""
        try:
            self._stream.write(content)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise can_not_write(self.name, error) from error

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
            raise can_not_write(self.name, error) from error

    def discard(self) -> None:
        """Leave what was there before; harmless after :meth:`close`."""
        if self.name != STANDARD_OUTPUT:
            # What is still buffered may not fit on the disk; it is thrown away in any case.
            with contextlib.suppress(OSError):
                self._stream.close()
        if self._draft is not None:
            self._draft.unlink(missing_ok=True)
            self._draft = None


class TextTarget(FileTarget[str]):
    """Text in UTF-8; ``-`` is standard output."""

    def _standard_output(self) -> IO[str]:
        return sys.stdout

    def _opened(self, file: int | str) -> IO[str]:
        return open(file, "w", encoding="utf-8", newline="\n")


class BytesTarget(FileTarget[bytes]):
    """Bytes as they are; ``-`` is standard output."""

    def _standard_output(self) -> IO[bytes]:
        return sys.stdout.buffer

    def _opened(self, file: int | str) -> IO[bytes]:
        return open(file, "wb")


class NpzTarget:
    """An archive on its way to ``name``; as :class:`TextTarget`, and a device or pipe gets the
    finished bytes at the end.
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
            raise can_not_write(name, error) from error

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Add rows to the array ``name``."""
        try:
            self._writer.append(name, rows)
        except OSError as error:
            raise can_not_write(self.name, error) from error

    def scalar(self, name: str, value: ArrayLike) -> None:
        """Write a number, a text or a short array under ``name``."""
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
            raise can_not_write(self.name, error) from error

    def discard(self) -> None:
        """Leave what was there before; harmless after :meth:`close`."""
        self._writer.discard()
        if self._folder is not None:
            self._folder.cleanup()


def _umask() -> int:
    """The process's file mode mask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask

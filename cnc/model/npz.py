"""Writing ``.npz`` files larger than memory.

``numpy.savez`` wants whole arrays; a trace or a pulse file grows with the program. Here the rows of
each array go to an unnamed temporary file as they come, and closing assembles them into an ordinary
archive that ``numpy.load`` reads without pickle. The same data make the same bytes: entries are
stored in the order of their first mention, uncompressed, with a fixed date.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import zipfile
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import ArrayLike, NDArray

EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest date that a zip entry can bear."""

COPY_BYTES = 1 << 20


class _Growing:
    """One array on its way: what its rows look like, how many there are, and the file that they
    wait in.
    """

    def __init__(self, folder: Path, first: NDArray[Any]) -> None:
        self.dtype = first.dtype
        self.tail = first.shape[1:]
        self.rows = 0
        self.file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - lives until the archive is closed

    def add(self, name: str, rows: NDArray[Any]) -> None:
        if rows.dtype != self.dtype or rows.shape[1:] != self.tail:
            raise ValueError(
                f"{name}: rows of {rows.dtype} {rows.shape[1:]} after rows of {self.dtype} {self.tail}"
            )
        self.file.write(np.ascontiguousarray(rows).data if rows.size else b"")
        self.rows += len(rows)


class NpzWriter:
    """An archive at ``path``, replaced as a whole on :meth:`close`; leaving a ``with`` block by an
    exception leaves the old file alone.

    Memory use does not depend on the number of rows. OSError where the folder can't be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._entries: dict[str, _Growing | NDArray[Any]] = {}
        self._closed = False
        tempfile.TemporaryFile(
            dir=self.path.parent
        ).close()  # better to fail before the work than after it

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Add ``rows`` (k, ...) to the array ``name``; k may be 0, which settles type and shape.
        ValueError if these differ from before.
        """
        entry = self._entries.get(name)
        if entry is None:
            if rows.dtype.hasobject or rows.ndim == 0:
                raise ValueError(f"{name}: rows of plain numbers or text are needed")
            entry = self._entries[name] = _Growing(self.path.parent, rows)
        if not isinstance(entry, _Growing):
            raise ValueError(f"{name}: already written as a whole")
        entry.add(name, rows)

    def scalar(self, name: str, value: ArrayLike) -> None:
        """Write ``value`` (a number, a text or a short array) under ``name``, in one go."""
        if name in self._entries:
            raise ValueError(f"{name}: already there")
        whole = np.asarray(value)
        if whole.dtype.hasobject:
            raise ValueError(f"{name}: plain numbers or text are needed")
        self._entries[name] = whole

    def close(self) -> None:
        """Assemble the archive and put it in place. A second call does nothing."""
        if self._closed:
            return
        part = self.path.with_name(self.path.name + ".part")
        try:
            with zipfile.ZipFile(part, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
                for name, entry in self._entries.items():
                    info = zipfile.ZipInfo(name + ".npy", EPOCH)
                    info.external_attr = 0o644 << 16
                    with archive.open(info, "w", force_zip64=True) as member:
                        _write_entry(member, entry)
            part.replace(self.path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
        finally:
            self.discard()

    def discard(self) -> None:
        """Throw away what has been collected."""
        self._closed = True
        for entry in self._entries.values():
            if isinstance(entry, _Growing):
                entry.file.close()

    def __enter__(self) -> NpzWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()


def _write_entry(member: IO[bytes], entry: _Growing | NDArray[Any]) -> None:
    """One array in numpy's own format, version 1.0."""
    if isinstance(entry, _Growing):
        shape: tuple[int, ...] = (entry.rows, *entry.tail)
        header = {
            "descr": npy_format.dtype_to_descr(entry.dtype),
            "fortran_order": False,
            "shape": shape,
        }
        npy_format.write_array_header_1_0(member, header)
        entry.file.seek(0)
        shutil.copyfileobj(entry.file, member, COPY_BYTES)
    else:
        npy_format.write_array(
            member,
            np.ascontiguousarray(entry) if entry.ndim else entry,
            version=(1, 0),
            allow_pickle=False,
        )

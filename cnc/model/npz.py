"""A writer of ``.npz`` files larger than memory.

``numpy.savez`` needs whole arrays, but a trace or a pulse file grows with the program. Here the
rows of each array go to an unnamed temporary file. Closing the writer assembles the archive, which
``numpy.load`` reads without pickle. Equal data make equal bytes: entries are stored in the order of
their first use, uncompressed, with a fixed date.
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
"""Earliest date that a zip entry can have."""

COPY_BYTES = 1 << 20


class _GrowingArray:
    """An array under construction: dtype and shape of its rows, their number, their file."""

    def __init__(self, folder: Path, first: NDArray[Any]) -> None:
        self.dtype = first.dtype
        self.tail = first.shape[1:]
        self.rows = 0
        # The file stays open until the archive is closed.
        self.file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115

    def add(self, name: str, rows: NDArray[Any]) -> None:
        if rows.dtype != self.dtype or rows.shape[1:] != self.tail:
            raise ValueError(
                f"{name}: rows of {rows.dtype} {rows.shape[1:]} "
                f"after rows of {self.dtype} {self.tail}"
            )
        self.file.write(np.ascontiguousarray(rows).data if rows.size else b"")
        self.rows += len(rows)


class NpzWriter:
    """A writer that replaces the archive at ``path`` as a whole on :meth:`close`.

    An exception inside its ``with`` block leaves the old file unchanged. Memory use does not depend
    on the number of rows.

    Raises:
        OSError: The folder is not writable.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._entries: dict[str, _GrowingArray | NDArray[Any]] = {}
        self._closed = False
        # A folder that is not writable must fail before the work, not after it.
        tempfile.TemporaryFile(dir=self.path.parent).close()

    def append(self, name: str, rows: NDArray[Any]) -> None:
        """Append rows to an array.

        Args:
            name: Name of the array.
            rows: Rows (k, ...); k may be 0, which fixes dtype and shape.

        Raises:
            ValueError: dtype or shape differ from those of earlier rows.
        """
        entry = self._entries.get(name)
        if entry is None:
            if rows.dtype.hasobject or rows.ndim == 0:
                raise ValueError(f"{name}: the rows must be numbers or text")
            entry = self._entries[name] = _GrowingArray(self.path.parent, rows)
        if not isinstance(entry, _GrowingArray):
            raise ValueError(f"{name}: this entry was written as a scalar")
        entry.add(name, rows)

    def scalar(self, name: str, value: ArrayLike) -> None:
        """Write ``value`` (a number, a text or a short array) under ``name``."""
        if name in self._entries:
            raise ValueError(f"{name}: this entry exists already")
        whole = np.asarray(value)
        if whole.dtype.hasobject:
            raise ValueError(f"{name}: the value must be numbers or text")
        self._entries[name] = whole

    def close(self) -> None:
        """Assemble the archive and replace the file. A second call does nothing."""
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
        """Delete the rows collected so far."""
        self._closed = True
        for entry in self._entries.values():
            if isinstance(entry, _GrowingArray):
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


def _write_entry(member: IO[bytes], entry: _GrowingArray | NDArray[Any]) -> None:
    """Write an array in numpy's format, version 1.0."""
    if isinstance(entry, _GrowingArray):
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

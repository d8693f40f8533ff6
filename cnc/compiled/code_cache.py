"""Places of compiled kernels on disk.

Compiled code is kept beside the sources, or in the user's cache folder where the sources are
read-only, or else in a private folder under the system's temporary folder.

    compiled/__pycache__/compiled/
        path.kernels.curve-cpython-312-1f0c.../     kernels of path/kernels/curve.py
            curve_eval-7b12....code         one kernel for one set of argument types
        path.kernels.bspline-cpython-312-77ab.../   kernels of another file, which call others

The code of a kernel depends on all kernels that it calls. So each source file has a folder of its
own, named by a digest of its text and of the texts of all kernel files that it imports. A change
compiles only the files that depend on it. The names do not contain the place of the sources, so
compiled code can be copied to another place: a wheel for one platform contains it
(:data:`SHIPPED`).

A file is written under another name and then renamed, so it is complete or not there. Two processes
that compile one kernel wait for each other. The operating system releases the lock of a process
that ends, however it ends.

The folders of earlier texts are removed when a process is about to compile. A folder in which code
was written within the last hour stays, since another process may still use it.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

_IMPORT = re.compile(r"^from cnc\.([\w.]+) import", re.MULTILINE)
_HERE = Path(__file__).parent
_SOURCES = _HERE.parent
_COMPILER = {
    _HERE / f"{name}.py"
    for name in (
        "borrowing",
        "code_cache",
        "code_library",
        "compiler",
        "compiler_work",
        "kernel_arguments",
        "lean_code",
        "loader",
        "values",
    )
}
_TAG = sys.implementation.cache_tag or sys.implementation.name
_KEPT_S = 3600.0
"""s. A folder of an earlier text stays so long after code was last written to it."""

_DIGEST_BYTES = hashlib.sha256().digest_size
"""Each file begins with a digest of its name and its code: a process that runs damaged code, or
the code of another kernel, crashes."""

SHIPPED = _HERE / "code"
"""Compiled code that was installed with the sources. It is only read."""


def _writable(folder: Path) -> bool:
    """Return whether a file can be made in ``folder``, which is created if need be.

    Permission bits do not answer this: root may write anywhere, and mounts may be read-only.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private_folder() -> Path:
    """Return a temporary folder that no other user can write to: code loaded from it runs."""
    if hasattr(os, "getuid"):
        folder = Path(tempfile.gettempdir()) / f"cnc-kernels-{os.getuid()}"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
            owned = found.st_uid == os.getuid() and stat.S_ISDIR(found.st_mode)
            if owned and not found.st_mode & 0o077:
                return folder
        except OSError:
            pass
    return Path(tempfile.mkdtemp(prefix="cnc-kernels-"))


_is_ours = "NUMBA_CACHE_DIR" not in os.environ


@cache
def cache_folder() -> Path:
    """Return the folder that holds the compiled code of all kernel files.

    A home folder that does not exist is not made, not even by root.
    """
    if not _is_ours:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    beside = _HERE / "__pycache__" / "compiled"
    named, home = os.environ.get("XDG_CACHE_HOME"), Path(os.path.expanduser("~"))
    installation = hashlib.sha256(str(_SOURCES).encode()).hexdigest()[:16]
    user_cache = Path(named or home / ".cache") / "cnc" / "compiled" / installation
    for folder in (beside, user_cache) if named or home.is_dir() else (beside,):
        if _writable(folder):
            return folder
    return _private_folder()


@cache
def _text(file: Path) -> bytes:
    """Return the contents of a source file; nothing for a file that is not there."""
    return file.read_bytes() if file.is_file() else b""


@cache
def _imports(file: Path) -> tuple[Path, ...]:
    """Return the kernel files that a file imports itself."""
    names = _IMPORT.findall(_text(file).decode())
    return tuple(_SOURCES.joinpath(*name.split(".")).with_suffix(".py") for name in names)


@cache
def _imported(file: Path) -> frozenset[Path]:
    """Return ``file`` and all kernel files that it imports, directly or not."""
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        here = waiting.pop()
        if here not in found:
            found.add(here)
            waiting += _imports(here)
    return frozenset(found)


def _digest(files: frozenset[Path]) -> str:
    """Return a short name for the texts of ``files`` and of the compiler, and Python's ABI."""
    total = hashlib.sha256(getattr(sys, "abiflags", "").encode())
    for file in sorted(files | _COMPILER):
        total.update(_text_digest(file))
    return total.hexdigest()[:16]


@cache
def _text_digest(file: Path) -> bytes:
    return hashlib.sha256(_text(file)).digest()


@cache
def folder_name(source: Path) -> str:
    """Return the name of the folder for the compiled code of a source file.

    The code of a file that cannot be read, such as one in a zip file, stays in memory.
    """
    if not source.is_file():
        return f"{_UNREADABLE}{source}"
    name = source.stem
    if source.is_relative_to(_SOURCES):
        name = ".".join(source.relative_to(_SOURCES).with_suffix("").parts)
    return f"{name}-{_TAG}-{_digest(_imported(source))}"


_UNREADABLE = "?"
"""Begins the name of the folder of a source file that cannot be read."""
_unwritten: dict[str, bytes] = {}
"""Code of this process that could not be written, by file."""


def find(file: str) -> bytes | None:
    """Return the contents of a file, of installed code or of this computer; None if it has none."""
    for place in (SHIPPED, cache_folder()):
        code = read(place, file)
        if code is not None:
            return code
    return _unwritten.get(file)


def keep(file: str, code: bytes) -> None:
    """Write a file of compiled code; keep it in memory if that fails, as on a full disk."""
    if file.startswith(_UNREADABLE) or not write(cache_folder(), file, code):
        _unwritten[file] = code


def read(place: str | Path, file: str) -> bytes | None:
    """Return the contents of a file of compiled code; None if there is none, or it is damaged.

    A start reads some 200 files. ``Path`` and a buffer would double the time of that.

    Args:
        place: the folder of all compiled code.
        file: folder and name of the file in there.
    """
    try:
        with open(os.path.join(place, file), "rb", buffering=0, opener=_open_at_once) as opened:
            data = opened.read() or b""
    except OSError:
        return None
    digest, code = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    return code if _digest_of(file, code) == digest else None


def _open_at_once(path: str, flags: int) -> int:
    """Open a file to read; a pipe of this name does not wait for a writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _digest_of(file: str, code: bytes) -> bytes:
    return hashlib.sha256(file.encode() + b"\0" + code).digest()


def write(place: Path, file: str, code: bytes) -> bool:
    """Write a file of compiled code, all of it or nothing; return whether that succeeded.

    The arguments are those of :func:`read`. A folder in the place of the file is removed.
    """
    path = place / file
    try:
        _make_folder(path.parent)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as new:
            temporary = Path(new.name)
            try:
                new.write(_digest_of(file, code) + code)
                new.close()
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
    except OSError:
        return False
    return True


def _make_folder(folder: Path) -> None:
    if not folder.is_dir():
        _remove_old_code()
        if folder.parent == cache_folder():
            folder.unlink(missing_ok=True)  # a file or a link to nothing in its place
        folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def locked(name: str) -> Iterator[None]:
    """Wait until no other process has locked this name, and lock it.

    Each name locks one byte of one file. The lock of a process that ends is released. Where the
    file system has no locks, nothing is locked, and two processes may compile one kernel.
    """
    offset = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big") >> 1
    held = False
    with suppress(OSError):
        lock_byte(_lock_file(), offset)
        held = True
    try:
        yield
    finally:
        if held:
            release_byte(_lock_file(), offset)


@cache
def _lock_file() -> int:
    """Return a descriptor of the file of locks; it stays open, since closing it releases them."""
    cache_folder().mkdir(parents=True, exist_ok=True)
    return os.open(cache_folder() / ".lock", os.O_RDWR | os.O_CREAT, 0o600)


if sys.platform == "win32":
    import msvcrt

    def lock_byte(file: int, offset: int) -> None:
        """Wait for a byte of a file, and lock it."""
        while True:
            os.lseek(file, offset, os.SEEK_SET)
            try:
                msvcrt.locking(file, msvcrt.LK_LOCK, 1)  # waits for 10 s
                return
            except PermissionError:
                continue

    def release_byte(file: int, offset: int) -> None:
        """Release a byte of a file."""
        os.lseek(file, offset, os.SEEK_SET)
        msvcrt.locking(file, msvcrt.LK_UNLCK, 1)

else:
    import fcntl

    def lock_byte(file: int, offset: int) -> None:
        """Wait for a byte of a file, and lock it."""
        fcntl.lockf(file, fcntl.LOCK_EX, 1, offset)

    def release_byte(file: int, offset: int) -> None:
        """Release a byte of a file."""
        fcntl.lockf(file, fcntl.LOCK_UN, 1, offset)


@cache
def _remove_old_code() -> None:
    """Remove the compiled code of earlier texts, once in a process.

    The folders of other versions of Python stay, and so do those in which code was written within
    the last hour. A process that still runs an earlier text makes its folder again when it writes.
    Two processes may do this at once.
    """
    if not _is_ours:
        return
    current = {folder_name(source) for source in _SOURCES.rglob("*/kernels/*.py")}
    oldest = time.time() - _KEPT_S
    other_python = re.compile(rf"-(?!{re.escape(_TAG)}-)\w+-\w+-[0-9a-f]{{16}}$")
    try:
        folders = [folder for folder in cache_folder().iterdir() if folder.is_dir()]
    except OSError:
        return
    for folder in folders:
        is_old = folder.name not in current and not other_python.search(folder.name)
        if is_old and _last_written(folder) < oldest:
            shutil.rmtree(folder, ignore_errors=True)


def _last_written(folder: Path) -> float:
    """Return the time at which anything in ``folder`` was last written, s since the epoch."""
    times = [0.0]
    # os.walk passes over folders that another process removes meanwhile; Path.rglob raises.
    for place, _, names in os.walk(folder):
        for path in (place, *(os.path.join(place, name) for name in names)):
            with suppress(OSError):
                times.append(os.stat(path).st_mtime)
    return max(times)

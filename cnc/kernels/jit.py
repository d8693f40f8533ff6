"""The one ``njit`` alias: cached compilation that survives a read-only home.

numba keeps compiled code beside the source file, or in the user's cache folder where that can't be written, and fails where neither can:
then a private folder under the system's temporary one takes its place.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _writable(folder: Path) -> bool:
    """Whether a file can be made in ``folder``, which is created if need be (permission bits don't tell: root, read-only mounts)."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private_folder() -> Path:
    """A folder under the system's temporary one that nobody else can write to: what is loaded from it runs."""
    if hasattr(os, "getuid"):
        folder = Path(tempfile.gettempdir()) / f"cnc-kernels-{os.getuid()}"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
            if found.st_uid == os.getuid() and stat.S_ISDIR(found.st_mode) and not found.st_mode & 0o077:
                return folder
        except OSError:
            pass
    return Path(tempfile.mkdtemp(prefix="cnc-kernels-"))


def _choose_cache_folder() -> Path:
    """The folder that compiled code is kept in; numba is pointed at it unless it would choose it by itself."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    beside = Path(__file__).parent / "__pycache__"
    if _writable(beside):
        return beside
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "cnc" / "kernels"
    folder = user_cache if _writable(user_cache) else _private_folder()
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    return folder


_cache_folder = _choose_cache_folder()

import numba  # noqa: E402 - reads NUMBA_CACHE_DIR when it is imported


def njit(function: Kernel) -> Kernel:
    """Compile ``function`` without Python objects, cached on disk."""
    return cast(Kernel, numba.njit(cache=True, error_model="numpy")(function))


def compiled_mark() -> Path | None:
    """The file whose presence says that these kernels, as they stand, were compiled for this Python and numba; None without a compiler."""
    if getattr(numba.config, "DISABLE_JIT", 0):
        return None
    sources = sorted(Path(__file__).parent.glob("*.py"))
    stamp = [(path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in sources]
    digest = hashlib.sha256(repr((sys.version, numba.__version__, stamp)).encode()).hexdigest()[:16]
    return _cache_folder / f"compiled-{digest}"

"""The one ``njit`` alias: cached compilation that survives a read-only home.

Compiled code is kept beside the sources, or in the user's cache folder where that can't be written, or else in a private folder under the
system's temporary one.
"""

from __future__ import annotations

import hashlib
import os
import shutil
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
    """The folder for the code of these kernels, as they stand; numba is pointed at it.

    numba looks only at the file that a kernel stands in, but its code holds that of every kernel it calls: the folder's name is theirs.
    """
    digest = hashlib.sha256(sys.version.encode())
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    own = f"kernels-{digest.hexdigest()[:16]}"
    if "NUMBA_CACHE_DIR" in os.environ:
        named = Path(os.environ["NUMBA_CACHE_DIR"])
        folder = named if named.name == own else named / own  # the former in a child of this process
    else:
        beside = Path(__file__).parent / "__pycache__"
        user_cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "cnc"
        base = beside if _writable(beside) else user_cache if _writable(user_cache) else _private_folder()
        folder = base / own
        if base == beside and not folder.exists():
            for stale in beside.glob("kernels-*"):
                shutil.rmtree(stale, ignore_errors=True)
    return folder


_cache_folder = _choose_cache_folder()
os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder)

import numba  # noqa: E402 - reads NUMBA_CACHE_DIR when it is imported
from numba.core.types import unliteral  # noqa: E402


def njit(function: Kernel) -> Kernel:
    """Compile ``function`` without Python objects, cached on disk.

    A constant in a call between kernels has a type of its own, for which numba would compile what is called once more: it is taken for a
    number like any other.
    """
    kernel: Any = numba.njit(cache=True, error_model="numpy")(function)
    if compiling():
        template = kernel.get_call_template
        kernel.get_call_template = lambda args, kws: template(tuple(unliteral(kind) for kind in args), kws)  # type: ignore[no-untyped-call]
    return cast(Kernel, kernel)


def compiling() -> bool:
    """Whether kernels are compiled, and not run as plain Python."""
    return not getattr(numba.config, "DISABLE_JIT", 0)


def compiled_mark() -> Path | None:
    """The file whose presence says that all kernels were compiled into this folder; None without a compiler."""
    if not compiling():
        return None
    return _cache_folder / f"compiled-{numba.__version__}"

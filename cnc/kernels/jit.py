"""The ``njit`` decorator: compilation with a cache on disk that survives a read-only home.

Compiled code is kept beside the sources, or in the user's cache folder where the sources are
read-only, or else in a private folder under the system's temporary folder.

    kernels/__pycache__/compiled/
        curve-1f0c.../       code of the kernels in curve.py
        fit-77ab.../         code of the kernels in fit.py; it contains code of curve.py

numba compares a kernel's code with its own file only, but the code contains that of every kernel
that it calls. So each file has a folder of its own, named by a digest of its text and of the texts
of all kernel files that it imports. A change compiles only the files that depend on it.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

_IMPORT = re.compile(r"^from cnc\.kernels\.([\w.]+) import", re.MULTILINE)


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


def _choose_cache_folder() -> Path:
    """Return the folder that holds the compiled code of all kernel files."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    beside = Path(__file__).parent / "__pycache__" / "compiled"
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    user_cache = home / "cnc" / "compiled"
    for folder in (beside, user_cache):
        if _writable(folder):
            return folder
    return _private_folder()


_cache_folder = _choose_cache_folder()
os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder)  # for child processes as well

import numba  # noqa: E402 - reads NUMBA_CACHE_DIR when it is imported
from numba.core.types import unliteral  # noqa: E402


@cache
def _text(file: Path) -> bytes:
    """Return the contents of a source file; nothing for a file that is not there."""
    return file.read_bytes() if file.is_file() else b""


@cache
def _imported(file: Path) -> frozenset[Path]:
    """Return ``file`` and all kernel files that it imports, directly or not."""
    folder = Path(__file__).parent
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        here = waiting.pop()
        if here not in found:
            found.add(here)
            names = _IMPORT.findall(_text(here).decode())
            waiting += [folder.joinpath(*name.split(".")).with_suffix(".py") for name in names]
    return frozenset(found)


def _digest(files: frozenset[Path]) -> str:
    """Return a short name for the texts of ``files`` and for this version of Python."""
    total = hashlib.sha256(sys.version.encode())
    for file in sorted(files):
        total.update(_text(file))
    return total.hexdigest()[:16]


def _folder_of(source: Path) -> Path:
    """Return the folder for the compiled code of one source file."""
    return _cache_folder / f"{source.stem}-{_digest(_imported(source))}"


def njit(function: Kernel) -> Kernel:
    """Compile ``function`` without Python objects, cached on disk.

    A constant in a call between kernels has a type of its own, for which numba would compile the
    called kernel once more: it is taken for a number like any other.
    """
    config: Any = numba.config
    config.CACHE_DIR = str(_folder_of(Path(function.__code__.co_filename)))
    kernel: Any = numba.njit(cache=True, error_model="numpy")(function)
    if compiling():
        template = kernel.get_call_template

        def without_literals(args: Any, kws: Any) -> Any:
            return template(tuple(unliteral(kind) for kind in args), kws)  # type: ignore[no-untyped-call]

        kernel.get_call_template = without_literals
    return cast(Kernel, kernel)


def compiling() -> bool:
    """Return whether kernels are compiled, and not run as plain Python."""
    return not getattr(numba.config, "DISABLE_JIT", 0)


def compiled_mark() -> Path | None:
    """Return the file whose presence shows that all kernels were compiled; None without a compiler.

    Its name changes with the text of any kernel.
    """
    if not compiling():
        return None
    everything = _digest(frozenset(Path(__file__).parent.rglob("*.py")))
    return _cache_folder / f"all-{everything}-{numba.__version__}"

"""The ``njit`` decorator: compilation with a cache on disk that survives a read-only home.

Compiled code is kept beside the sources, or in the user's cache folder where the sources are
read-only, or else in a private folder under the system's temporary folder.

    kernels/__pycache__/compiled/
        path.curve-cpython-312-1f0c.../   code of the kernels in path/curve.py
        path.fit-cpython-312-77ab.../     code of the kernels in path/fit.py, and of path/curve.py

numba compares a kernel's code with its own file only, but the code contains that of every kernel
that it calls. So each file has a folder of its own, named by a digest of its text and of the texts
of all kernel files that it imports. A change compiles only the files that depend on it. The names
do not contain the place of the sources, so the compiled code can be copied to another place.

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
import uuid
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

_IMPORT = re.compile(r"^from cnc\.kernels\.([\w.]+) import", re.MULTILINE)
_SOURCES = Path(__file__).parent
_TAG = sys.implementation.cache_tag or sys.implementation.name
_OURS = uuid.uuid4().hex[:12]
"""Part of the names of files that this process writes."""
_KEPT_S = 3600.0
"""s. A folder of an earlier text stays so long after code was last written to it."""


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
    beside = _SOURCES / "__pycache__" / "compiled"
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    installation = hashlib.sha256(str(_SOURCES).encode()).hexdigest()[:16]
    user_cache = home / "cnc" / "compiled" / installation
    for folder in (beside, user_cache):
        if _writable(folder):
            return folder
    return _private_folder()


_is_ours = "NUMBA_CACHE_DIR" not in os.environ
_cache_folder = _choose_cache_folder()
os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder)  # for child processes as well

import numba  # noqa: E402 - reads NUMBA_CACHE_DIR when it is imported
from numba.core.caching import UserProvidedCacheLocator  # noqa: E402
from numba.core.types import unliteral  # noqa: E402


class FolderOfFile(UserProvidedCacheLocator):
    """Tells numba to keep a kernel's code in ``numba.config.CACHE_DIR`` itself.

    numba would add a subfolder that is named by the path of the sources.
    """

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return no subfolder."""
        return ""


@cache
def _text(file: Path) -> bytes:
    """Return the contents of a source file; nothing for a file that is not there."""
    return file.read_bytes() if file.is_file() else b""


@cache
def _imported(file: Path) -> frozenset[Path]:
    """Return ``file`` and all kernel files that it imports, directly or not."""
    found: set[Path] = set()
    waiting = [file]
    while waiting:
        here = waiting.pop()
        if here not in found:
            found.add(here)
            names = _IMPORT.findall(_text(here).decode())
            waiting += [_SOURCES.joinpath(*name.split(".")).with_suffix(".py") for name in names]
    return frozenset(found)


def _digest(files: frozenset[Path]) -> str:
    """Return a short name for the texts of ``files`` and for this version of Python."""
    total = hashlib.sha256(sys.version.encode())
    for file in sorted(files):
        total.update(_text(file))
    return total.hexdigest()[:16]


def _folder_of(source: Path) -> Path:
    """Return the folder for the compiled code of one source file."""
    name = source.stem
    if source.is_relative_to(_SOURCES):
        name = ".".join(source.relative_to(_SOURCES).with_suffix("").parts)
    return _cache_folder / f"{name}-{_TAG}-{_digest(_imported(source))}"


@cache
def _remove_old_code() -> None:
    """Remove the compiled code of earlier texts, once in a process.

    The folders of other versions of Python stay, and so do those in which code was written within
    the last hour. A process that still runs an earlier text makes its folder again when it writes.
    Two processes may do this at once.
    """
    if not _is_ours:
        return
    current = {_folder_of(source) for source in _SOURCES.rglob("*.py")}
    oldest = time.time() - _KEPT_S
    other_python = re.compile(rf"-(?!{re.escape(_TAG)}-)\w+-\w+-[0-9a-f]{{16}}$")
    try:
        folders = [folder for folder in _cache_folder.iterdir() if folder.is_dir()]
    except OSError:
        return
    for folder in folders:
        is_old = folder not in current and not other_python.search(folder.name)
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


def njit(function: Kernel) -> Kernel:
    """Compile ``function`` without Python objects, cached on disk.

    Kernels in a zip file are not cached, because numba needs the time of a source file. No kernel
    is called from C, so the wrapper for that is left out; it costs 5 % of the compilation.

    A constant in a call between kernels has a type of its own, for which numba would compile the
    called kernel once more. Here it has the type of its value.
    """
    config: Any = numba.config
    numba_njit: Any = numba.njit  # its stub lacks an option
    source = Path(function.__code__.co_filename)
    folder = _folder_of(source)
    if compiling() and not folder.exists():
        _remove_old_code()
    compiler = numba_njit(cache=source.is_file(), error_model="numpy", no_cfunc_wrapper=True)
    config.CACHE_DIR, classes = str(folder), config.CACHE_LOCATOR_CLASSES
    config.CACHE_LOCATOR_CLASSES = f"{__name__}.{FolderOfFile.__name__}"
    try:
        kernel: Any = compiler(function)
    finally:
        config.CACHE_LOCATOR_CLASSES = classes
    if compiling():
        if source.is_file():
            # numba numbers the files of a kernel's variants. Two processes that write at once would
            # use one number for two variants, and one of them would then run the other's code.
            files = kernel._cache._cache_file
            files._data_name_pattern = files._data_name_pattern.replace(".nbc", f".{_OURS}.nbc")
        template = kernel.get_call_template

        def without_literals(args: Any, kws: Any) -> Any:
            return template(tuple(unliteral(kind) for kind in args), kws)  # type: ignore[no-untyped-call]

        kernel.get_call_template = without_literals
    return cast(Kernel, kernel)


def interpreted(kernel: Kernel) -> Kernel:
    """Return a kernel as plain Python, for single calls that are not worth a compilation."""
    return cast(Kernel, getattr(kernel, "py_func", kernel))


def compiling() -> bool:
    """Return whether kernels are compiled, and not run as plain Python."""
    return not getattr(numba.config, "DISABLE_JIT", 0)


def compiled_mark() -> Path | None:
    """Return the file whose presence shows that all kernels were compiled; None without a compiler.

    Its name changes with the text of any kernel.
    """
    if not compiling():
        return None
    everything = _digest(frozenset(_SOURCES.rglob("*.py")))
    return _cache_folder / f"all-{everything}-{numba.__version__}"

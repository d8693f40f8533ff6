"""The one ``njit`` alias: cached compilation that survives a read-only home.

numba keeps compiled code beside the source file, or in the user's cache folder where that can't be written, and fails where neither can:
then a private folder under the system's temporary one takes its place.
"""

from __future__ import annotations

import os
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


def _choose_cache_folder() -> None:
    """Point numba at a folder that can be written, unless the user named one or the default ones will do."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    if _writable(Path(__file__).parent / "__pycache__"):
        return
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cnc" / "kernels"
    if _writable(user_cache):
        os.environ["NUMBA_CACHE_DIR"] = str(user_cache)
        return
    owner = os.getuid() if hasattr(os, "getuid") else "user"
    private = Path(tempfile.gettempdir()) / f"cnc-kernels-{owner}"
    private.mkdir(mode=0o700, exist_ok=True)
    os.environ["NUMBA_CACHE_DIR"] = str(private)


_choose_cache_folder()

import numba  # noqa: E402 - reads NUMBA_CACHE_DIR when it is imported


def njit(function: Kernel) -> Kernel:
    """Compile ``function`` without Python objects, cached on disk."""
    return cast(Kernel, numba.njit(cache=True, error_model="numpy")(function))

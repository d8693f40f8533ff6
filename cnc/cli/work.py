"""The modules with the work of commands, and the library, imported when they are first used."""

from __future__ import annotations

import gc
import os
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cnc.cli import checking, language_server, measuring, operating, projects, rewriting

__all__ = ["checking", "language_server", "measuring", "operating", "projects", "rewriting"]

NEW_OBJECTS = 10_000
"""New objects after which the collector looks for garbage among them."""


def __getattr__(name: str) -> ModuleType:
    """Import a module of ``__all__``, and the library before it, when it is used first."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    load_library()
    return import_module(f"cnc.cli.{name}")


def load_library() -> None:
    """Import :mod:`cnc.api`, with its objects excluded from garbage collection.

    They live as long as the process, and the collector would visit them again and again: during
    the import it would take a tenth of the time. Later it visits the new objects less often than
    Python's default of 700: a long program has many blocks, none of which is in a cycle.
    """
    gc.disable()
    # The threads of linear algebra would only wait: no matrix here is large.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # pydantic would search all installed packages for extensions of itself.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        import_module("cnc.api")
    finally:
        gc.freeze()
        gc.set_threshold(NEW_OBJECTS)
        gc.enable()

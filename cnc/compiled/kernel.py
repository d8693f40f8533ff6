"""Kernels, which are compiled when they are first called, and the types of their arguments.

LLVM is imported when a kernel is called, and numba when one is compiled: each takes as long as
``cncrun --help``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from cnc.compiled import code_cache

compiled_modules: ContextVar[frozenset[str] | None] = ContextVar("compiled_modules", default=None)
"""Modules whose kernels are compiled; None for all."""


class Kernel:
    """A function that is compiled when it is first called.

    Args:
        function: the Python function.
        compiler_of: returns the dispatcher of numba that compiles a kernel.
        releases_gil: whether other threads run Python while it runs.

    Attributes:
        py_func: the Python function.
        name: its name in its module.
        releases_gil: whether other threads run Python while it runs.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        compiler_of: Callable[[Kernel], Any],
        *,
        releases_gil: bool = False,
    ) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self._compiler_of = compiler_of
        self.name = function.__qualname__
        self.releases_gil = releases_gil
        self._entries: dict[Any, Callable[..., Any]] = {}
        kernels[function.__module__, function.__qualname__] = self

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function; compile it if need be."""
        entries = self._entries
        entry = entries.get(tuple(map(kind, arguments))) if entries else None
        return (entry or self._first_call)(*arguments)

    def _first_call(self, *arguments: Any) -> Any:
        """Call the kernel for types that are new."""
        modules = compiled_modules.get()
        if modules is not None and self.__module__ not in modules:
            return self.py_func(*arguments)
        entry = self._entry(arguments)
        self._entries[tuple(map(kind, arguments))] = entry
        return entry(*arguments)

    def _entry(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """Load the compiled function for such arguments; compile it if need be."""
        from cnc.compiled import loader

        types = ",".join(types_text(kind(each)) for each in arguments)
        files = loader.file_names(self.folder, self.name, types, ".wrapper")
        variables = self.py_func.__globals__
        entry = loader.first_entry(files, variables)
        if entry is None:
            self.dispatcher.wrap(arguments, files[-1])
            entry = loader.first_entry(files, variables)
            assert entry is not None
        return entry

    @functools.cached_property
    def dispatcher(self) -> Any:
        """The dispatcher of numba for this function, which compiles it."""
        return self._compiler_of(self)

    @property
    def _numba_type_(self) -> Any:
        """Its type to kernels that call it; numba asks for this attribute."""
        return self.dispatcher._numba_type_

    @functools.cached_property
    def plain(self) -> Callable[..., Any]:
        """The Python function, which calls other kernels as Python functions too."""
        function, callees = self.py_func, self._callees_by_name()
        if not callees:
            return function
        names = {**function.__globals__, **{name: each.plain for name, each in callees.items()}}
        return FunctionType(function.__code__, names, self.name, function.__defaults__)

    @property
    def folder(self) -> str:
        """Name of the folder of its compiled code."""
        return code_cache.folder_name(Path(self.py_func.__code__.co_filename))

    @property
    def is_on_disk(self) -> bool:
        """Whether there is compiled code, for whatever types and processor."""
        places = (code_cache.SHIPPED, code_cache.cache_folder())
        return any(
            next((place / self.folder).glob(f"{self.name}-*.code"), None) is not None
            for place in places
        )

    @property
    def label(self) -> str:
        """Name for people: ``path.curve.curve_eval``."""
        return f"{self.__module__.removeprefix('cnc.').replace('.kernels.', '.')}.{self.name}"

    def callees(self) -> list[Kernel]:
        """Return the kernels that this one calls itself."""
        return list(self._callees_by_name().values())

    def _callees_by_name(self) -> dict[str, Kernel]:
        """Return the kernels that this one calls itself, by their names in its module."""
        names = self.py_func.__globals__
        found = {name: names.get(name) for name in self.py_func.__code__.co_names}
        return {name: each for name, each in found.items() if isinstance(each, Kernel)}


kernels: dict[tuple[str, str], Kernel] = {}
"""All kernels of the imported modules, by module and name."""

watchers: list[Callable[[Kernel], None]] = []
"""Functions that are called before a kernel is compiled."""


# Types of the arguments of a call, for which a kernel is compiled or loaded.

_LAYOUT = 0x1 | 0x2 | 0x100 | 0x400
"""Flags of an array on which compiled code depends: C and Fortran order, aligned, writable."""


def kind(value: Any) -> Any:
    """Return what a call depends on: types, dimensions and order of arrays.

    Raises:
        TypeError: If kernels do not take such a value.
    """
    cls = type(value)
    if cls is np.ndarray:
        return value.dtype, value.ndim, value.flags.num & _LAYOUT
    if cls in _PLAIN:
        return cls
    if issubclass(cls, tuple):
        return cls, *map(kind, value)
    if issubclass(cls, np.ndarray):
        return kind(value.view(np.ndarray))
    if issubclass(cls, np.generic):
        return cls, value.dtype
    raise TypeError(f"kernels do not take a {cls.__name__}")


_PLAIN: dict[type, str] = {
    bool: "b1",
    np.bool_: "b1",
    int: "i8",
    float: "f8",
    np.float64: "f8",
    str: "text",
}
_PLAIN[type(None)] = "none"


def types_text(kinds: Any) -> str:
    """Return a text for the result of :func:`kind` that is the same in all processes."""
    if isinstance(kinds, type):
        return _PLAIN[kinds]
    first, *others = kinds
    if isinstance(first, np.dtype):
        dimensions, flags = others
        # One row is in both orders; to the compiler its order is C.
        order = flags & ~0x2 if flags & 0x1 else flags
        return f"{_dtype_text(first)}[{dimensions}:{order:x}]"
    if issubclass(first, np.generic):
        return _dtype_text(others[0])
    return f"{first.__module__}.{first.__qualname__}({','.join(map(types_text, others))})"


def _dtype_text(dtype: np.dtype[Any]) -> str:
    return dtype.str[1:] if dtype.isnative and dtype.names is None else repr(dtype)

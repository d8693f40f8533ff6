"""The ``njit`` decorator: functions that are compiled when they are first called.

Compiled code is kept on disk (:mod:`cnc.compiled.code_cache`) and loaded from there
(:mod:`cnc.compiled.loader`). numba compiles a kernel for one set of argument types when it is
called from Python, or when a kernel that calls it is compiled (:mod:`cnc.compiled.compiler`). LLVM
and numba are imported then, because that takes as long as ``cncrun --help``.

Inside :func:`as_python`, a kernel whose code has not been loaded runs as plain Python. A small
program is read so, while nothing is compiled.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

from cnc.compiled import code_cache
from cnc.compiled.argument_types import kind, types_text

Function = TypeVar("Function", bound=Callable[..., Any])

_compiled: ContextVar[frozenset[str] | None] = ContextVar("_compiled", default=None)
"""Modules whose kernels are compiled; None for all."""


class Kernel:
    """A function that is compiled when it is first called.

    Attributes:
        py_func: the Python function.
        name: its name in its module.
        releases_gil: whether other threads run Python while it runs.
    """

    def __init__(self, function: Callable[..., Any], *, releases_gil: bool = False) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
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
        modules = _compiled.get()
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
        from cnc.compiled.compiler import KernelDispatcher

        return KernelDispatcher(self)

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


def njit(function: Function) -> Function:
    """Compile ``function`` without Python objects when it is first called, cached on disk."""
    if not compiling():
        return function
    return cast(Function, Kernel(function))


def njit_for_threads(function: Function) -> Function:
    """Compile ``function`` as :func:`njit` does, for calls from several threads at once."""
    if not compiling():
        return function
    return cast(Function, Kernel(function, releases_gil=True))


def interpreted(kernel: Function) -> Function:
    """Return a kernel as plain Python, for single calls that are not worth a compilation.

    The kernels that it calls are plain Python too.
    """
    return cast(Function, kernel.plain if isinstance(kernel, Kernel) else kernel)


def compiling() -> bool:
    """Return whether kernels are compiled, and not run as plain Python."""
    return os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")


@contextmanager
def as_python(*, except_in: frozenset[str] = frozenset()) -> Iterator[None]:
    """Run kernels that have not been loaded as plain Python, except those of some modules."""
    before = _compiled.set(except_in)
    try:
        yield
    finally:
        _compiled.reset(before)

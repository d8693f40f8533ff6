"""The ``njit`` decorator: functions that are compiled when they are first called.

Compiled code is kept on disk (:mod:`cnc.compiled.code_cache`) and loaded from there
(:mod:`cnc.compiled.loader`). numba compiles a kernel for one set of argument types when it is
called from Python, or when a kernel that calls it is compiled (:mod:`cnc.compiled.compiler`). LLVM
and numba are imported then, because that takes as long as ``cncrun --help``.

Inside :func:`as_python`, a kernel whose code has not been loaded runs as plain Python. A small
program is read so, while nothing is compiled.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar, cast

from cnc.compiled.kernel import Kernel, compiled_modules

Function = TypeVar("Function", bound=Callable[..., Any])


def _compiler_of(kernel: Kernel) -> Any:
    """Return the dispatcher of numba that compiles a kernel."""
    from cnc.compiled.compiler import KernelDispatcher

    return KernelDispatcher(kernel)


def njit(function: Function) -> Function:
    """Compile ``function`` without Python objects when it is first called, cached on disk."""
    if not compiling():
        return function
    return cast(Function, Kernel(function, _compiler_of))


def njit_for_threads(function: Function) -> Function:
    """Compile ``function`` as :func:`njit` does, for calls from several threads at once."""
    if not compiling():
        return function
    return cast(Function, Kernel(function, _compiler_of, releases_gil=True))


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
    before = compiled_modules.set(except_in)
    try:
        yield
    finally:
        compiled_modules.reset(before)

"""Room on the interpreter's stack for functions that call deeply.

CPython keeps the variables of running functions in chunks of 16 kB. It takes a chunk from the
operating system when a call does not fit in the last one, and gives it back when the call returns.
A loop at the end of a chunk does so at each call: that costs more than the call itself. numba's
compiler, which calls some hundred functions deep, spent a tenth of its time so.

A chunk is as large as its first function needs, and up to twice as large. So below a function that
needs much, there is room for all functions that it calls.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import FunctionType
from typing import TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., object])

_SLOTS = 68_000
"""Values for which a function asks room: 544 kB, so that the chunk has 1 MB, and half of it is left
over. Memory that is not written to costs nothing."""


def with_room(function: Function) -> Function:
    """Return a function that does the same, in a chunk of its own with room for deep calls."""
    python = cast(FunctionType, function)
    wide = FunctionType(
        python.__code__.replace(co_stacksize=python.__code__.co_stacksize + _SLOTS),
        python.__globals__,
        python.__name__,
        python.__defaults__,
        python.__closure__,
    )
    wide.__kwdefaults__ = python.__kwdefaults__
    return cast(Function, functools.update_wrapper(wide, python))

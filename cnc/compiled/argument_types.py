"""Types of the arguments of a call, for which a kernel is compiled or loaded."""

from __future__ import annotations

from typing import Any

import numpy as np

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

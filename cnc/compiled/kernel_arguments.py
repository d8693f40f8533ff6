"""How arguments are passed between kernels: each number, pointer and size of an array by itself.

numba passes all seven fields of an array, and both sizes and strides of each axis. A named tuple of
ten arrays so becomes a hundred arguments. The fields of an array that is contiguous, in C's order,
follow from few of them:

    passed      counts of references, data, shape
    computed    number of elements, strides
    known       size of an element; no Python object

Numba's own functions, and kernels of others, take their arguments as before.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any
from unittest.mock import patch

from llvmlite import ir as llvm
from numba.core import types
from numba.core.base import BaseContext
from numba.core.callconv import BaseCallConv
from numba.core.datamodel import ArgPacker
from numba.core.types.containers import BaseTuple

META, PARENT, ITEMS, ITEM_SIZE, DATA, SHAPE, STRIDES = range(7)
"""Fields of an array in numba's structure."""

Path = tuple[int, ...]

_packer_of = BaseCallConv._get_arg_packer
_declare = BaseContext.declare_function


class KernelArguments(tuple[Any, ...]):
    """The argument types of a kernel, whose arguments are passed as above."""

    def __reduce__(self) -> Any:
        return KernelArguments, (tuple(self),)

    def packer(self, context: Any) -> KernelPacker:
        """Return what takes such arguments apart."""
        if not hasattr(self, "_packer"):
            self._packer = KernelPacker(context, self)
        return self._packer


@contextmanager
def passed_briefly() -> Iterator[None]:
    """Pass arguments between kernels as above, inside the ``with`` statement."""
    with (
        patch.object(BaseCallConv, "_get_arg_packer", _packer),
        patch.object(BaseContext, "declare_function", _declared),
    ):
        yield


def _packer(convention: Any, arguments: Any) -> Any:
    """Return what takes arguments apart."""
    if isinstance(arguments, KernelArguments):
        return arguments.packer(convention.context)
    return _packer_of(convention, arguments)


def _declared(context: Any, module: Any, descriptor: Any) -> Any:
    """Return a function of a module; declare it unless it is declared."""
    found = module.globals.get(descriptor.mangled_name)
    return _declare(context, module, descriptor) if found is None else found


class KernelPacker:
    """Takes the arguments of a kernel apart, and puts them together again.

    Args:
        context: numba's context.
        arguments: the types of the arguments.
    """

    def __init__(self, context: Any, arguments: KernelArguments) -> None:
        self._parts = [_Part(context, each) for each in arguments]

    @cached_property
    def argument_types(self) -> tuple[Any, ...]:
        """LLVM's types of all that is passed."""
        return tuple(type for part in self._parts for type in part.types)

    def as_arguments(self, builder: Any, values: Any) -> tuple[Any, ...]:
        """Return all that is passed for some values."""
        pairs = zip(self._parts, values, strict=True)
        return tuple(each for part, value in pairs for each in part.taken_apart(builder, value))

    def from_arguments(self, builder: Any, passed: Any) -> list[Any]:
        """Return the values for which something was passed."""
        rest = iter(passed)
        return [part.together(builder, rest) for part in self._parts]

    def assign_names(self, arguments: Any, names: Any) -> None:
        """Leave the arguments without names."""


class _Part:
    """One argument: the places of arrays and other values inside of tuples.

    Arrays are passed in short. What else there is, numba takes apart.

    Attributes:
        types: LLVM's types of what is passed.
    """

    def __init__(self, context: Any, type: Any) -> None:
        self._context = context
        self._start = _constant(context, type)
        models = context.data_model_manager
        self._places = [
            (path, inner, None if _is_short(inner) else ArgPacker(models, [inner]))
            for path, inner in _places(type)
        ]
        self.types = [
            each
            for _, inner, numbas in self._places
            for each in (self._passed(inner) if numbas is None else numbas.argument_types)
        ]

    def _passed(self, type: Any) -> tuple[Any, ...]:
        """Return LLVM's types of what is passed for an array."""
        fields = self._context.get_value_type(type).elements
        return fields[META], fields[DATA], *[fields[SHAPE].element] * type.ndim

    def taken_apart(self, builder: Any, value: Any) -> Iterator[Any]:
        """Yield what is passed for a value."""
        for path, type, numbas in self._places:
            if numbas is None:
                for field in (META,), (DATA,), *((SHAPE, axis) for axis in range(type.ndim)):
                    yield builder.extract_value(value, path + field)
            else:
                inner = builder.extract_value(value, path) if path else value
                yield from numbas.as_arguments(builder, [inner])

    def together(self, builder: Any, passed: Iterator[Any]) -> Any:
        """Return the value for which the next arguments were passed."""
        value = self._start
        for path, type, numbas in self._places:
            if numbas is None:
                value = self._array(builder, type, value, path, passed)
            else:
                parts = [next(passed) for _ in numbas.argument_types]
                inner = numbas.from_arguments(builder, parts)
                value = builder.insert_value(value, inner[0], path) if path else inner[0]
        return value

    def _array(self, builder: Any, type: Any, value: Any, path: Path, passed: Iterator[Any]) -> Any:
        """Return the value with an array put in place, whose item size and last stride it has."""
        fields: dict[Path, Any] = {(META,): next(passed), (DATA,): next(passed)}
        shape = [next(passed) for _ in range(type.ndim)]
        items, stride = shape[-1], _item_size(self._context, type)
        for axis in range(type.ndim - 1, -1, -1):
            fields[SHAPE, axis] = shape[axis]
            if axis < type.ndim - 1:
                stride = builder.mul(stride, shape[axis + 1])
                fields[STRIDES, axis] = stride
                items = builder.mul(items, shape[axis])
        fields[ITEMS,] = items
        for field, inner in fields.items():
            value = builder.insert_value(value, inner, path + field)
        return value


def _is_short(type: Any) -> bool:
    """Return whether a value is passed in short."""
    return type.__class__ is types.Array and type.layout == "C" and type.ndim > 0


def _places(type: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the places of all values inside of tuples, and their types."""
    if isinstance(type, BaseTuple) and len(type) > 0:
        for k, inner in enumerate(type):
            yield from _places(inner, (*path, k))
    else:
        yield path, type


def _item_size(context: Any, type: Any) -> Any:
    return context.get_constant(
        types.intp, context.get_abi_sizeof(context.get_data_type(type.dtype))
    )


def _constant(context: Any, type: Any) -> Any:
    """Return the parts of a value that are the same for all values of its type."""
    of_type = context.get_value_type(type)
    if isinstance(type, BaseTuple) and len(type) > 0:
        return llvm.Constant(of_type, [_constant(context, inner) for inner in type])
    if not _is_short(type):
        return llvm.Constant(of_type, llvm.Undefined)
    fields = [llvm.Constant(each, None) for each in of_type.elements]
    fields[ITEM_SIZE] = _item_size(context, type)
    strides = [context.get_constant(types.intp, 0)] * (type.ndim - 1)
    fields[STRIDES] = llvm.Constant(of_type.elements[STRIDES], [*strides, fields[ITEM_SIZE]])
    return llvm.Constant(of_type, fields)

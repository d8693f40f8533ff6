"""LLVM code without detours that numba generates, and that LLVM would have to find and remove.

A profile by kind of instruction showed that two thirds of the code move values about:

- Each use of an array stores all its seven fields in memory, and loads those that are needed.
- Index and shape of an array are taken apart twice for each element.
- Each call of a function clears the place of the value twice, has a place of its own for an
  exception, which is then copied, computes six properties of the status, of which callers use one,
  and looks whether it is inside a ``try``.
- Variables are cleared where they are last used, though no references are counted in them. Where
  they are, all fields are in memory, and not the references alone.
- An exception about the shapes of arrays has a text with both: each kernel that writes to a part
  of an array contains thousands of lines that join texts.

The machine code does the same. It is mostly the same code, which is found in less time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, cast
from unittest.mock import patch

from llvmlite import ir as llvm
from llvmlite.ir import IRBuilder
from numba.core import cgutils, ir, types
from numba.core.analysis import compute_cfg_from_blocks
from numba.core.callconv import (
    RETCODE_EXC,
    RETCODE_NONE,
    RETCODE_OK,
    RETCODE_STOPIT,
    RETCODE_USEREXC,
    CPUCallConv,
)
from numba.core.compiler_machinery import register_pass
from numba.core.extending import overload
from numba.core.lowering import Lower
from numba.core.typed_passes import NativeLowering
from numba.core.types.misc import MemInfoPointer
from numba.np import arrayobj

from cnc.compiled.borrowing import owned_variables
from cnc.compiled.kernel_arguments import KernelArguments
from cnc.compiled.values import extracted, set_once

_make_array = arrayobj.make_array
_index = arrayobj.basic_indexing
_call = CPUCallConv.call_function
_propagate = CPUCallConv.return_status_propagate
_check_try = CPUCallConv.check_try_status
_COUNT = MemInfoPointer(types.voidptr)
_TRY_STATE = "_CPUCallConv__eh_try_state"
"""Attribute of numba's builder of code where a function has a ``try``."""


@contextmanager
def detours_left_out() -> Iterator[None]:
    """Generate code without the detours, inside the ``with`` statement."""
    with ExitStack() as stack:
        for owner, name, function in (
            (IRBuilder, "extract_value", extracted),
            (arrayobj, "make_array", _array),
            (arrayobj, "basic_indexing", _indexed),
            (arrayobj, "raise_with_shape_context", _refuse_shape),
            (CPUCallConv, "call_function", _called),
            (CPUCallConv, "_get_return_status", _status),
            (CPUCallConv, "return_status_propagate", _propagated),
            (CPUCallConv, "check_try_status", _checked_try),
        ):
            stack.enter_context(patch.object(owner, name, function))
        yield


class KernelLower(Lower):  # type: ignore[misc]
    """Generates the code of a kernel. References are counted where the kernel owns the arrays."""

    def __init__(self, context: Any, library: Any, fndesc: Any, *rest: Any, **named: Any) -> None:
        fndesc.argtypes = KernelArguments(fndesc.argtypes)
        super().__init__(context, library, fndesc, *rest, **named)

    def lower_function_body(self) -> Any:
        """Generate the code, when it is known which variables own arrays."""
        models = self.context.data_model_manager
        self._owned = owned_variables(self.blocks, self.fndesc.typemap, models)
        graph = compute_cfg_from_blocks(self.blocks)
        once = set_once(self.blocks, graph)
        self._singly_assigned_vars |= once.keys() - self._owned
        kept = once.keys() & self._owned - self._singly_assigned_vars
        self._kept: dict[str, Any] = dict.fromkeys(kept)
        self._set_again = {name for name in kept if graph.in_loops(once[name])}
        self._references: dict[str, list[Any]] = {}
        return super().lower_function_body()

    def lower_inst(self, inst: Any) -> Any:
        """Generate code of an instruction; count only what goes into a variable that owns it."""
        if not isinstance(inst, ir.Assign) or inst.target.name in self._owned:
            return super().lower_inst(inst)
        counts = self.library.counts_references
        self.library.counts_references = False
        try:
            return super().lower_inst(inst)
        finally:
            self.library.counts_references = counts

    def loadvar(self, name: str) -> Any:
        """Return the value of a variable."""
        return self._kept.get(name) or super().loadvar(name)

    def storevar(self, value: Any, name: str, argidx: Any = None) -> None:
        """Store a value; what the variable had before is let go if it owned that."""
        if name in self._kept:
            self._keep(value, name)
        elif name in self._owned:
            super().storevar(value, name, argidx)
        elif name in self._singly_assigned_vars:
            self._blk_local_varmap[name] = value
        else:
            self._alloca_var(name, self.typeof(name))
            self.builder.store(value, self.getvar(name))

    def delvar(self, name: str) -> None:
        """Let go what a variable owns."""
        if name in self._kept:
            self._let_go(name)
        elif name in self._owned:
            super().delvar(name)

    def _alloca_var(self, name: str, type: Any) -> None:
        if name not in self._kept:
            super()._alloca_var(name, type)

    def _keep(self, value: Any, name: str) -> None:
        """Keep a value. Of an owner, references are in memory: it may be let go without a value."""
        if name in self._set_again:
            self._let_go(name)
        counts = self.context.nrt.get_meminfos(self.builder, self.typeof(name), value)
        for (_, count), place in zip(counts, self._places(name), strict=True):
            self.builder.store(count, place)
        self._kept[name] = value

    def _let_go(self, name: str) -> None:
        for place in self._places(name):
            self.decref(_COUNT, self.builder.load(place))
            self.builder.store(llvm.Constant(place.type.pointee, None), place)

    def _places(self, name: str) -> list[Any]:
        """Return the places in memory of the references that a variable owns."""
        if name not in self._references:
            kind = self.typeof(name)
            none = llvm.Constant(self.context.get_value_type(kind), llvm.Undefined)
            counts = self.context.nrt.get_meminfos(self.builder, kind, none)
            self._references[name] = [
                cgutils.alloca_once(self.builder, count.type) for _, count in counts
            ]
        return self._references[name]


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelLowering(NativeLowering):  # type: ignore[misc]
    """numba's pass that generates code, with :class:`KernelLower`."""

    _name = "kernel_lowering"

    @property
    def lowering_class(self) -> type:
        """The class that generates code."""
        return KernelLower


class _ArrayValue:
    """An array whose fields are read from its value.

    It stands for numba's class, which keeps the fields in memory. That is made where more is wanted
    of it than to be read.
    """

    def __init__(self, kind: Any, context: Any, builder: Any, value: Any) -> None:
        fields = {"_kind": kind, "_context": context, "_builder": builder, "_value": value}
        model = context.data_model_manager[kind]
        self.__dict__.update(fields, _positions=model.get_field_position, _stored=None)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or self._stored is not None:
            return getattr(self._in_memory(), name)
        return self._builder.extract_value(self._value, self._positions(name))

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._in_memory(), name, value)

    def _getvalue(self) -> Any:
        return self._value if self._stored is None else self._stored._getvalue()

    def _in_memory(self) -> Any:
        if self._stored is None:
            stored = _make_array(self._kind)(self._context, self._builder, value=self._value)
            self.__dict__["_stored"] = stored
        return self._stored


def _array(kind: Any) -> Any:
    """Return what makes an array from its value, as numba's class does."""
    if type(kind) is not types.Array:
        return _make_array(kind)

    def make(context: Any, builder: Any, value: Any = None, ref: Any = None) -> Any:
        if value is None or ref is not None:
            return _make_array(kind)(context, builder, value=value, ref=ref)
        return _ArrayValue(kind, context, builder, value)

    return make


def _indexed(
    context: Any,
    builder: Any,
    kind: Any,
    array: Any,
    index_types: Any,
    indices: Any,
    boundscheck: Any = None,
) -> Any:
    """Return place, shape and strides of a part of an array, as numba does.

    Integers that select from a contiguous array, in C's order, need less code than all the rest.
    """
    integers = all(isinstance(each, types.Integer) for each in index_types)
    if boundscheck or kind.layout != "C" or not integers or not indices:
        return _index(context, builder, kind, array, index_types, indices, boundscheck)
    shape = cgutils.unpack_tuple(builder, array.shape, kind.ndim)
    place, step = None, None
    for axis in range(kind.ndim - 1, -1, -1):
        if axis < len(indices):
            index = _from_start(context, builder, index_types[axis], indices[axis], shape[axis])
            term = index if step is None else builder.mul(index, step)
            place = term if place is None else builder.add(place, term)
        step = shape[axis] if step is None else builder.mul(step, shape[axis])
    rest = shape[len(indices) :]
    strides = cgutils.unpack_tuple(builder, array.strides, kind.ndim) if rest else []
    return builder.gep(array.data, [place]), rest, strides[len(indices) :]


def _refuse_shape(src_shapes: Any, index_shape: Any) -> None:
    """Raise an exception: an array does not have the shape of the part that it is written to."""


overload(_refuse_shape)(arrayobj.ol_raise_with_shape_context_generic)


def _from_start(context: Any, builder: Any, kind: Any, index: Any, size: Any) -> Any:
    """Return an index counted from the start of an axis; a negative one counts from its end."""
    if isinstance(index, llvm.Constant) and index.constant >= 0:
        return context.cast(builder, index, kind, types.intp)
    return arrayobj.fix_integer_index(context, builder, kind, index, size)


class _Status:
    """Properties of the status that a function returns; their code is generated where it is used.

    Attributes:
        code: the status.
        excinfoptr: the exception, if there is one; None if the caller of the function has it.
    """

    def __init__(self, builder: Any, code: Any, excinfoptr: Any) -> None:
        self._builder = builder
        self.code, self.excinfoptr = code, excinfoptr

    def _is(self, comparison: str, status: Any) -> Any:
        return self._builder.icmp_signed(comparison, self.code, status)

    @property
    def is_ok(self) -> Any:
        """Whether there is no exception."""
        return self._builder.or_(self._is("==", RETCODE_OK), self.is_none)

    @property
    def is_error(self) -> Any:
        """Whether there is an exception."""
        return self._builder.not_(self.is_ok)

    @property
    def is_none(self) -> Any:
        """Whether there is no value."""
        return self._is("==", RETCODE_NONE)

    @property
    def is_python_exc(self) -> Any:
        """Whether Python has the exception."""
        return self._is("==", RETCODE_EXC)

    @property
    def is_user_exc(self) -> Any:
        """Whether compiled code has made an exception."""
        return self._is(">=", RETCODE_USEREXC)

    @property
    def is_stop_iteration(self) -> Any:
        """Whether a generator has ended."""
        return self._is("==", RETCODE_STOPIT)


def _called(
    convention: Any,
    builder: Any,
    callee: Any,
    result: Any,
    kinds: Any,
    values: Any,
    attributes: Any = None,
) -> tuple[Any, Any]:
    """Call a function. Return its status, and its value, which counts if there is no exception.

    The caller of a function without ``try`` receives the exception from where it is made.
    """
    passed_on = not hasattr(builder, _TRY_STATE) and _receives_exception(builder.function)
    if not passed_on or attributes is not None:
        return cast(
            "tuple[Any, Any]",
            _call(convention, builder, callee, result, kinds, values, attributes),
        )
    with builder.goto_entry_block():
        place = builder.alloca(convention.get_return_type(result).pointee)
    exception = convention._get_excinfo_argument(builder.function)
    arguments = convention._get_arg_packer(kinds).as_arguments(builder, values)
    code = builder.call(callee, [place, exception, *arguments])
    value = convention.context.get_returned_value(builder, result, builder.load(place))
    return _Status(builder, code, None), value


def _receives_exception(function: Any) -> bool:
    """Return whether the caller of a function has given a place for an exception."""
    return len(function.args) > 1 and function.args[1].name == "excinfo"


def _status(_: Any, builder: Any, code: Any, excinfoptr: Any) -> _Status:
    """Return the properties of a status."""
    return _Status(builder, code, excinfoptr)


def _propagated(convention: Any, builder: Any, status: Any) -> None:
    """Pass an exception on to the caller; inside a ``try`` as numba does."""
    if hasattr(builder, _TRY_STATE):
        _propagate(convention, builder, status)
    else:
        if status.excinfoptr is not None:
            builder.store(status.excinfoptr, convention._get_excinfo_argument(builder.function))
        convention._return_errcode_raw(builder, status.code)


def _checked_try(convention: Any, builder: Any) -> Any:
    """Return whether the code is inside a ``try``: nothing where a function has none so far."""
    return _check_try(convention, builder) if hasattr(builder, _TRY_STATE) else None

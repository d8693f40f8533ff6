"""Work that numba's compiler repeats without need, and that is done once here.

The machine code stays the same, byte for byte. A profile of all kernels showed these repetitions:

- The meaning of a call is searched anew at each call.
- All modules with functions that numba knows are looked up for each function.
- The variables that are alive at each place are found after each pass. Only the last result is
  used.
- The variables of an instruction are found by up to five questions about the class of each part.
- Counts of references are looked for in values that have none, such as numbers.
- Each call of LLVM is reported to a clock for each compilation in progress.
- A context manager for each instruction adds the place to an error. It is a generator, though
  hardly ever is there an error.
- Attempts that fail have messages in colour.
- LLVM parses a module to find the size of a type, each time.
- The signature of each function that generates code is read at each call, to find whether it has
  an argument for the place in the source.
- Messages for the log are offered for each instruction, though nobody reads them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

from llvmlite.binding import ffi
from numba.core import base, errors, event, ir, lowering, ssa, transforms, typeinfer
from numba.core.base import BaseContext as TargetContext
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.runtime.context import NRTContext
from numba.core.types import Function
from numba.core.typing.context import BaseContext as TypingContext

_call_types: dict[Any, Any] = {}
"""Signatures of numba's own functions, by function and argument types."""
_find_call_type = Function.get_call_type
_refresh_target, _refresh_typing = TargetContext.refresh, TypingContext.refresh
_known: dict[int, dict[int, int]] = {}
"""Number of registrations that the contexts of one target know, by registry (its ``id``)."""
_process = PostProcessor.run
_find_references = NRTContext.get_meminfos
_references: dict[Any, bool] = {}
"""Whether values of a type have counts of references."""
_find_size = TargetContext.get_abi_sizeof
_sizes: dict[Any, int] = {}
"""Sizes of LLVM's types, bytes. There is one processor for which a process compiles."""
_find_takes_place = base._has_loc
_place_takers: dict[Any, bool] = {}
"""Whether functions of numba have an argument for the place in the source."""


@contextmanager
def repeated_work_left_out() -> Iterator[None]:
    """Compile without the repeated work, inside the ``with`` statement."""
    with ExitStack() as stack:
        for owner, name, function in (
            (Function, "get_call_type", _call_type),
            (TargetContext, "refresh", _refreshed_target),
            (TypingContext, "refresh", _refreshed_typing),
            (PostProcessor, "run", _processed),
            (NRTContext, "get_meminfos", _references_of),
            (ir.Inst, "_rec_list_vars", _variables),
            (event, "broadcast", _ignored),
            (ffi.lib._lock, "_cblist", []),
            (TargetContext, "get_abi_sizeof", _size),
            (base, "_has_loc", _takes_place),
            (ssa, "_logger", _SILENT),
            (lowering, "new_error_context", _ErrorContext),
            (typeinfer, "new_error_context", _ErrorContext),
        ):
            stack.enter_context(patch.object(owner, name, function))
        stack.enter_context(patch.object(errors, "_termcolor_inst", _PLAIN, create=True))
        yield


def _call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
    """Return the type of a call of numba's own function as numba finds it, but find it once.

    numba tries all that a function may mean for each call: an addition of two numbers is looked up
    among the functions of arrays first, a few thousand times. The answer depends on the types
    alone.
    """
    key = (function, args, tuple(kws.items()))
    found = _call_types.get(key)
    if found is None:
        found = _call_types[key] = _find_call_type(function, context, args, kws)
    return found


def _refreshed_target(context: Any) -> None:
    """Let a target know new functions."""
    if id(context._registries) not in _known:
        _refresh_target(context)
    _install_new(context)
    _install_new(context.typing_context)


def _refreshed_typing(context: Any) -> None:
    """Let the type inference know new functions."""
    if id(context._registries) not in _known:
        _refresh_typing(context)
    _install_new(context)


def _install_new(context: Any) -> None:
    """Install what was registered since the last time.

    The contexts of one target share their registries, which live as long as the process.
    """
    known = _known.setdefault(id(context._registries), {})
    for registry, loader in tuple(context._registries.items()):
        size = sum(len(getattr(registry, name)) for name in loader.registry_items)
        if known.get(id(registry)) != size:
            known[id(registry)] = size
            context.install_registry(registry)


def _processed(processor: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Process a function after a pass; find the lives of variables when they are asked for."""
    function = processor.func_ir
    if emit_dels or function.is_generator:
        _process(processor, emit_dels=emit_dels, extend_lifetimes=extend_lifetimes)
        return
    function.blocks = transforms.canonicalize_cfg(function.blocks)
    function.variable_lifetime = VariableLifetime(function.blocks)
    function.generator_info = None


def _references_of(runtime: Any, builder: Any, type: Any, value: Any) -> Any:
    """Return the counts of references in a value; nothing at once if its type has none."""
    found = _references.get(type)
    if found is None:
        model = runtime._context.data_model_manager[type]
        found = _references[type] = model.contains_nrt_meminfo()
    return _find_references(runtime, builder, type, value) if found else []


def _size(context: Any, type: Any) -> int:
    """Return the size of an LLVM type, bytes."""
    found = _sizes.get(type)
    if found is None:
        found = _sizes[type] = _find_size(context, type)
    return found


def _takes_place(function: Any) -> bool:
    """Return whether a function of numba has an argument for the place in the source."""
    found = _place_takers.get(function)
    if found is None:
        found = _place_takers[function] = _find_takes_place(function)
    return found


def _variables(_: ir.Inst, value: Any) -> list[ir.Var]:
    """Return the variables in a part of an instruction."""
    found: list[ir.Var] = []
    _add_variables((value,), found)
    return found


def _add_variables(values: Iterable[Any], found: list[ir.Var]) -> None:
    for value in values:
        add = _adders.get(value.__class__)
        if add is None:
            add = _adders[value.__class__] = _adder(value.__class__)
        if add is not _ignored:
            add(value, found)


def _adder(cls: type) -> Callable[[Any, list[ir.Var]], None]:
    """Return what finds the variables in a value of this class."""
    if issubclass(cls, ir.Var):
        return lambda value, found: found.append(value)
    if issubclass(cls, ir.Inst):
        return lambda value, found: found.extend(value.list_vars())
    if issubclass(cls, list | tuple):
        return _add_variables
    if issubclass(cls, dict):
        return lambda value, found: _add_variables(value.values(), found)
    return _ignored


def _ignored(*_: Any) -> None:
    """Do nothing."""


_adders: dict[type, Callable[[Any, list[ir.Var]], None]] = {}
"""What finds the variables in a value, by its class."""


class _ErrorContext:
    """Adds to an error where it happened, as numba does.

    Args:
        parts: the arguments of numba's function for this.
        named: its named arguments.
    """

    __slots__ = ("_named", "_parts")

    def __init__(self, *parts: Any, **named: Any) -> None:
        self._parts, self._named = parts, named

    def __enter__(self) -> None:
        pass

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is not None:
            with errors.new_error_context(*self._parts, **self._named):  # type: ignore[attr-defined]
                raise error


class _Silent:
    """A logger whose messages nobody reads."""

    debug = _ignored


class _Plain:
    """Messages without colours, for :func:`numba.core.errors.termcolor`."""

    def __getattr__(self, style: str) -> Callable[[str], str]:
        return str


_PLAIN = _Plain()
_SILENT = _Silent()

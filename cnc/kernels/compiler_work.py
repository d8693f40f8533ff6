"""Work that numba's compiler repeats without need, and that is done once here.

The machine code stays the same, byte for byte. A profile of all kernels showed these repetitions:

- The meaning of a call is searched anew at each call.
- All modules with functions that numba knows are looked up for each function.
- The variables that are alive at each place are found after each pass. Only the last result is
  used.
- Attempts that fail have messages in colour.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

from numba.core import errors, transforms
from numba.core.base import BaseContext as TargetContext
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.types import Function
from numba.core.typing.context import BaseContext as TypingContext

_call_types: dict[Any, Any] = {}
"""Signatures of numba's own functions, by function and argument types."""
_find_call_type = Function.get_call_type
_refresh_target, _refresh_typing = TargetContext.refresh, TypingContext.refresh
_known: dict[int, dict[int, int]] = {}
"""Number of registrations that the contexts of one target know, by registry (its ``id``)."""
_process = PostProcessor.run


@contextmanager
def repeated_work_left_out() -> Iterator[None]:
    """Compile without the repeated work, inside the ``with`` statement."""
    with ExitStack() as stack:
        for owner, name, function in (
            (Function, "get_call_type", _call_type),
            (TargetContext, "refresh", _refreshed_target),
            (TypingContext, "refresh", _refreshed_typing),
            (PostProcessor, "run", _processed),
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


class _Plain:
    """Messages without colours, for :func:`numba.core.errors.termcolor`."""

    def __getattr__(self, style: str) -> Callable[[str], str]:
        return str


_PLAIN = _Plain()

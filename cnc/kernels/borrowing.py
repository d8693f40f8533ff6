"""Kernels that make no arrays: their callers hold all arrays that they use.

numba counts the references to an array wherever one is passed, indexed or forgotten. Where all
arrays belong to the callers, no count changes anything: the callers hold them until the kernel
returns. Without counting, there is less code to generate, to read and to optimise.

Whether a kernel makes arrays shows in the types of its instructions. Where that is wrong, its code
calls numba's functions for new arrays, and it is compiled again, with counting
(:mod:`cnc.kernels.compiler`).
"""

from __future__ import annotations

from typing import Any

from numba.core import ir
from numba.core.compiler_machinery import register_pass
from numba.core.runtime.context import NRTContext
from numba.core.typed_passes import NopythonRewrites
from numba.core.types import Array, NamedTupleClass
from numba.core.types.containers import BaseTuple

HANDED_ON = {
    "build_tuple",
    "cast",
    "exhaust_iter",
    "getattr",
    "getiter",
    "iternext",
    "pair_first",
    "pair_second",
    "static_getitem",
}
"""Operations whose value contains arrays of their operands only."""
_count = NRTContext._call_incref_decref


@register_pass(mutates_CFG=True, analysis_only=False)
class ArrayRewrites(NopythonRewrites):  # type: ignore[misc]
    """numba's pass that merges operations on whole arrays, for kernels that make arrays only."""

    _name = "array_rewrites"

    def run_pass(self, state: Any) -> bool:
        """Run the pass where a kernel makes arrays; let the others be compiled without counting."""
        library = state.library
        library.counts_references = library.counts_references or makes_arrays(state)
        return bool(super().run_pass(state)) if library.counts_references else False


def makes_arrays(state: Any) -> bool:
    """Return whether a function makes an array, or receives one from a function that it calls.

    Args:
        state: numba's state of its compilation, after the inference of types.
    """
    models = state.targetctx.data_model_manager

    def has_arrays(type: Any) -> bool:
        return bool(models[type].contains_nrt_meminfo())

    return has_arrays(state.return_type) or any(
        has_arrays(state.typemap[target.name]) and not _is_borrowed(value, state.typemap)
        for target, value in _assignments(state.func_ir)
    )


def _assignments(function: Any) -> Any:
    """Yield targets and values of all assignments of expressions."""
    for block in function.blocks.values():
        for each in block.body:
            if isinstance(each, ir.Assign) and isinstance(each.value, ir.Expr):
                yield each.target, each.value


def _is_borrowed(value: Any, types: Any) -> bool:
    """Return whether the arrays in the value of an expression belong to its operands.

    An index that is an array, or contains one, selects elements into a new array.
    """
    if value.op == "getitem":
        index = types[value.index.name]
        parts = index.types if isinstance(index, BaseTuple) else (index,)
        return not any(isinstance(part, Array) for part in parts)
    if value.op == "call":
        return isinstance(types[value.func.name], NamedTupleClass)
    return value.op in HANDED_ON


def count_where_needed(runtime: Any, builder: Any, type: Any, value: Any, function: str) -> None:
    """Generate code that counts the references in a value, as numba does, unless it is left out."""
    library = runtime._context.active_code_library
    if getattr(library, "counts_references", True):
        _count(runtime, builder, type, value, function)

"""Arrays that kernels borrow: their callers hold them, so that their references need no count.

numba counts the references to an array wherever one is passed, indexed or forgotten. Where an array
belongs to the caller, no count changes anything: the caller holds it until the kernel returns. So
references are counted in variables that own what they hold: new arrays, parts of them, and what is
returned. Without the other counts, there is less code to generate, to read and to optimise.

Whether a variable owns arrays shows in the instructions. A kernel whose code makes no array, not
even inside of numba's functions, contains no counts (:mod:`cnc.compiled.code_library`).
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
    "phi",
    "static_getitem",
}
"""Operations whose value contains arrays of their operands only."""
_count = NRTContext._call_incref_decref


@register_pass(mutates_CFG=True, analysis_only=False)
class ArrayRewrites(NopythonRewrites):  # type: ignore[misc]
    """numba's pass that merges operations on whole arrays, for kernels that make arrays only."""

    _name = "array_rewrites"

    def run_pass(self, state: Any) -> bool:
        """Run the pass where a kernel makes arrays."""
        models = state.targetctx.data_model_manager
        owned = owned_variables(state.func_ir.blocks, state.typemap, models)
        return bool(super().run_pass(state)) if owned else False


def owned_variables(blocks: Any, types: Any, models: Any) -> set[str]:
    """Return the variables that own references to arrays: what they hold has to be let go.

    A variable owns them if one of its values is a new array, or a part of what another such
    variable owns, or is returned. All others borrow: what they hold comes from arguments.

    Args:
        blocks: the instructions of a function.
        types: the types of its variables.
        models: numba's models of types.
    """
    owned: set[str] = set()
    sources: list[tuple[str, set[str]]] = []
    for each in (each for block in blocks.values() for each in block.body):
        if isinstance(each, ir.Return):
            owned.add(each.value.name)
        elif isinstance(each, ir.Assign) and isinstance(each.value, ir.Expr | ir.Var):
            if _is_handed_on(each.value, types):
                sources.append((each.target.name, _variables(each.value)))
            else:
                owned.add(each.target.name)
    holds = {name: bool(models[types[name]].contains_nrt_meminfo()) for name, _ in sources}
    owned = {name for name in owned if models[types[name]].contains_nrt_meminfo()}
    size = -1
    while owned and len(owned) > size:
        size = len(owned)
        owned |= {name for name, parts in sources if holds[name] and not parts.isdisjoint(owned)}
    return owned


def _variables(value: Any) -> set[str]:
    return {value.name} if isinstance(value, ir.Var) else {each.name for each in value.list_vars()}


def _is_handed_on(value: Any, types: Any) -> bool:
    """Return whether the arrays in a value belong to its operands.

    An index that is an array, or contains one, selects elements into a new array.
    """
    if isinstance(value, ir.Var):
        return True
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

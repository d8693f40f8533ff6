"""Values of LLVM's code that are used directly: not by way of memory, or of a structure.

numba keeps a variable in memory if one block sets it and another uses it. Where a kernel uses one
field of a tuple of twenty arrays, its code loads all of them, hence some hundred numbers. Arguments
are put together to a structure, and taken apart for each use. LLVM would undo all this: it would
take each structure apart, number by number, and find what is never used.

A variable that is set once keeps its value here, where the place that sets it is passed before each
use. A field of a structure is the value that was put into it. What nothing uses then is left out.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

from llvmlite import ir as llvm
from llvmlite.ir import instructions as code
from numba.core import ir
from numba.core.analysis import compute_use_defs

Path = tuple[int, ...]

WITHOUT_EFFECT = (code.InsertValue, code.ExtractValue, code.LoadInstr, code.CastInstr)
"""Instructions that are left out where nothing uses their values."""


def set_once(blocks: Any, graph: Any) -> dict[str, int]:
    """Return the variables that have the value of one instruction wherever they are used.

    Args:
        blocks: the instructions of a function, in blocks by their order.
        graph: numba's graph of the blocks.

    Returns:
        The block that sets each.
    """
    places: dict[str, list[int]] = {}
    for offset, block in blocks.items():
        for each in block.find_insts(ir.Assign):
            places.setdefault(each.target.name, []).append(offset)
    found = {name: offsets[0] for name, offsets in places.items() if len(offsets) == 1}
    passed_before = graph.dominators()
    for offset, used in compute_use_defs(blocks).usemap.items():
        for name in used & found.keys():
            # The code of the blocks is generated in their order.
            if found[name] >= offset or found[name] not in passed_before[offset]:
                del found[name]
    return found


class _Fields:
    """What was put into a structure.

    Attributes:
        base: the structure before that.
        values: by place.
        inside: places of which parts were put in place by themselves.
    """

    def __init__(self, structure: Any) -> None:
        self.values: dict[Path, Any] = {}
        self.inside: set[Path] = set()
        while isinstance(structure, code.InsertValue):
            path = tuple(structure.indices)
            starts = [path[:k] for k in range(len(path))]
            # What was put in place later counts.
            if path not in self.values and not any(start in self.values for start in starts):
                self.values[path] = structure.value
                self.inside.update(starts)
            structure = structure.aggregate
        self.base = structure


def extracted(builder: Any, structure: Any, index: Any, name: str = "") -> Any:
    """Return a field of a structure: what was put into it, or else by an instruction.

    Args:
        builder: numba's builder of code.
        structure: the structure.
        index: place of the field, in one or more steps.
        name: its name in the code.
    """
    path: Path = tuple(index) if isinstance(index, tuple | list) else (index,)
    while path:
        if isinstance(structure, code.InsertValue):
            if not hasattr(structure, "fields"):
                structure.fields = _Fields(structure)
            fields = structure.fields
            if path in fields.inside:
                break
            starts = (path[:k] for k in range(len(path), 0, -1))
            start = next((start for start in starts if start in fields.values), ())
            structure, path = fields.values.get(start, fields.base), path[len(start) :]
        elif isinstance(structure, code.ExtractValue):
            path = *structure.indices, *path
            structure = structure.aggregate
            if not isinstance(structure, code.InsertValue):
                break
        elif isinstance(structure, llvm.Constant) and isinstance(structure.constant, list | tuple):
            structure, path = structure.constant[path[0]], path[1:]
        else:
            break
    if not path:
        return structure
    return _extracted_once(builder, structure, path, name)


def _extracted_once(builder: Any, structure: Any, path: Path, name: str) -> Any:
    """Return a field of a structure by an instruction; by an earlier one if the block has it."""
    block = builder.block
    if not hasattr(block, "fields"):
        block.fields = {}
    key = id(structure), path  # as part of an instruction, the structure lives as long as the block
    found = block.fields.get(key)
    at_end = builder._anchor == len(block.instructions)
    if found is None or not at_end:
        found = code.ExtractValue(block, structure, path, name=name)
        builder._insert(found)
        if at_end:
            block.fields[key] = found
    return found


def leave_out_unused(module: Any) -> None:
    """Leave out instructions whose values nothing uses."""
    for function in module.functions:
        if function.blocks:
            _leave_out_unused(function.blocks)


def _leave_out_unused(blocks: Any) -> None:
    uses = Counter(
        id(operand)
        for block in blocks
        for each in block.instructions
        for operand in _operands(each)
    )
    for block in reversed(blocks):
        kept = []
        for each in reversed(block.instructions):
            if isinstance(each, WITHOUT_EFFECT) and not uses[id(each)]:
                uses.subtract(map(id, each.operands))
            else:
                kept.append(each)
        block.instructions = kept[::-1]


def _operands(instruction: Any) -> Any:
    if isinstance(instruction, code.PhiInstr):
        return [value for value, _ in instruction.incomings]
    return instruction.operands

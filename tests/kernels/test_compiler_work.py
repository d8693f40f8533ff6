"""Work that the compiler leaves out: the results are those of numba with all its work."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from cnc.compiled import jit

pytestmark = pytest.mark.skipif(not jit.compiling(), reason="kernels run as plain Python")


def test_a_function_of_numba_is_looked_up_once_for_the_same_types(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import operator

    from numba.core import types
    from numba.core.registry import cpu_target

    from cnc.compiled import compiler_work

    context, found = cpu_target.typing_context, []
    context.refresh()
    of_numba = types.Function.get_call_type

    def find(*arguments: Any) -> Any:
        found.append(arguments)
        return of_numba(*arguments)

    monkeypatch.setattr(compiler_work, "_find_call_type", find)
    monkeypatch.setattr(compiler_work, "_call_types", {})
    cases = [
        (operator.add, (types.float64, types.int64)),
        (operator.add, (types.int64, types.int64)),
        (operator.lt, (types.float64, types.int64)),
        (operator.getitem, (types.float64[:], types.int64)),
        (operator.getitem, (types.float64[:, ::1], types.int64)),
    ]
    for _ in range(3):
        for function, arguments in cases:
            known = context.resolve_value_type(function)
            signature = compiler_work._call_type(known, context, arguments, {})
            assert signature == of_numba(known, context, arguments, {})
    assert len(found) == len(cases)


def triple() -> None:
    """Stand for a function that a module of numba registers when it is imported."""


def test_a_function_that_is_registered_later_becomes_known() -> None:
    from numba.core import types
    from numba.core.registry import cpu_target
    from numba.core.typing.templates import AbstractTemplate, infer_global, signature

    from cnc.compiled.compiler_work import repeated_work_left_out

    context = cpu_target.typing_context

    with repeated_work_left_out():
        context.refresh()

        @infer_global(triple)
        class Triple(AbstractTemplate):  # type: ignore[misc]
            key = triple

            def generic(self, args: Any, kws: Any) -> Any:
                return signature(types.int64, *args)

        context.refresh()
    assert context.resolve_function_type(triple, (types.int64,), {}).return_type == types.int64


def _statements(function: Any) -> Iterator[Any]:
    """Yield the instructions of a function, and those that they are made of."""
    from numba.core import compiler, ir

    for block in compiler.run_frontend(function).blocks.values():
        for statement in block.body:
            yield statement
            if isinstance(getattr(statement, "value", None), ir.Inst):
                yield statement.value


def _many_kinds(values: Any, *, count: int = 3) -> float:
    total, pair = 0.0, (values[0], values[1:count])
    table = {"first": pair[0]}
    for index, value in enumerate(values):
        values[index] = value if index % 2 else -value
        total += max(value, table["first"], pair[1][0]) + sorted(values, reverse=True)[0]
        if total > 1e3:
            del pair
            raise ValueError("too much", total)
    return total


def test_the_variables_of_instructions_are_those_that_numba_finds() -> None:
    from numba.core import ir

    from cnc.compiled.compiler_work import repeated_work_left_out

    def listed() -> list[list[str]]:
        return [[str(each) for each in found.list_vars()] for found in _statements(_many_kinds)]

    expected = listed()
    assert max(map(len, expected)) > 3
    before = ir.Inst._rec_list_vars
    with repeated_work_left_out():
        assert ir.Inst._rec_list_vars is not before
        assert listed() == expected


def test_counts_of_references_are_looked_for_where_a_type_has_them() -> None:
    from llvmlite import ir as llvm
    from numba.core import types
    from numba.core.registry import cpu_target

    from cnc.compiled.compiler_work import repeated_work_left_out

    context = cpu_target.target_context.subtarget(enable_nrt=True)
    context.refresh()
    array = types.Array(types.float64, 1, "C")
    with_references = types.Tuple((types.int64, array, types.UniTuple(array, 2)))
    number = types.UniTuple(types.float64, 3)

    def counts(type: Any) -> tuple[list[Any], int]:
        """Return the types of the counts, and the number of instructions that find them."""
        module = context.create_module("m")
        value = context.get_value_type(type)
        function = llvm.Function(module, llvm.FunctionType(llvm.VoidType(), [value]), "f")
        builder = llvm.IRBuilder(function.append_basic_block())
        found = context.nrt.get_meminfos(builder, type, function.args[0])
        return [each for each, _ in found], len(builder.block.instructions)

    expected, work = counts(with_references)
    assert len(expected) == 3
    assert counts(number)[1]
    with repeated_work_left_out():
        found, less = counts(with_references)
        assert found == expected
        assert less < work
        assert counts(number) == ([], 0)


@pytest.mark.parametrize(
    "function",
    [lambda x: len([x * n for n in range(3)]), lambda x: (lambda y: y + x)(1.0)],
    ids=["comprehension", "function inside"],
)
def test_a_function_inside_of_a_kernel_is_refused(function: Any) -> None:
    from numba.core.errors import NumbaError

    with pytest.raises(NumbaError):
        jit.njit(function)(np.float64(2.0))


def _wrong(x: float) -> float:
    total = x + 1.0
    return total + x.missing


def test_an_error_names_its_place_as_that_of_numba_does() -> None:
    from numba.core import compiler
    from numba.core.errors import TypingError
    from numba.core.registry import cpu_target
    from numba.core.types import float64

    from cnc.compiled.compiler_work import repeated_work_left_out

    def error() -> tuple[str, list[str]]:
        with pytest.raises(TypingError) as found:
            compiler.compile_extra(
                cpu_target.typing_context,
                cpu_target.target_context,
                _wrong,
                (float64,),
                None,
                compiler.Flags(),
                {},
            )
        # Colours, which numba adds where colorama is installed, do not count.
        plain = [
            re.sub(r"\x1b\[\d*m", "", text) for text in (found.value.msg, *found.value.contexts)
        ]
        return plain[0], plain[1:]

    expected = error()
    assert any("missing" in each for each in (expected[0], *expected[1]))
    with repeated_work_left_out():
        assert error() == expected


def test_the_size_of_a_type_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from llvmlite import ir as llvm
    from numba.core import types
    from numba.core.base import BaseContext
    from numba.core.registry import cpu_target

    from cnc.compiled import compiler_work

    context, found = cpu_target.target_context, []
    context.refresh()
    of_numba = BaseContext.get_abi_sizeof

    def find(*arguments: Any) -> Any:
        found.append(arguments)
        return of_numba(*arguments)

    monkeypatch.setattr(compiler_work, "_find_size", find)
    monkeypatch.setattr(compiler_work, "_sizes", {})
    array = context.get_value_type(types.Array(types.float64, 2, "C"))
    pair = llvm.LiteralStructType([llvm.IntType(8), llvm.IntType(64)])
    packed = llvm.LiteralStructType([llvm.IntType(8), llvm.IntType(64)], packed=True)
    sizes = {llvm.IntType(32): 4, llvm.DoubleType(): 8, pair: 16, packed: 9, array: 9 * 8}
    with compiler_work.repeated_work_left_out():
        for _ in range(3):
            for type, size in sizes.items():
                assert context.get_abi_sizeof(type) == size
    assert len(found) == len(sizes)


def test_functions_that_take_the_place_in_the_source_are_known() -> None:
    from numba.core import base

    from cnc.compiled.compiler_work import repeated_work_left_out

    def with_place(context: Any, builder: Any, *, loc: Any = None) -> None:
        """Generate code."""

    def without(context: Any, builder: Any) -> None:
        """Generate code."""

    with repeated_work_left_out():
        for _ in range(2):
            assert base._has_loc(with_place)
            assert not base._has_loc(without)

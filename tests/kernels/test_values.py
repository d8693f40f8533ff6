"""Values that are used directly: variables that are set once, fields of structures, owners."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest
from llvmlite import ir

from cnc.compiled import jit
from tests.support.paths import ROOT

pytestmark = [
    pytest.mark.own_code,
    pytest.mark.skipif(not jit.compiling(), reason="kernels run as plain Python"),
]

KERNELS = '''
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


class Many(NamedTuple):
    one: Pair
    two: Pair
    three: Pair
    four: Pair
    five: Pair
    six: Pair


@njit
def new_pair(n: int):
    """Return two arrays, which the caller owns."""
    return Pair(np.arange(n) + 0.5, np.ones(n + 1))


@njit
def last(pair: Pair, n: int):
    """Use after a loop what the loop sets each time."""
    here = pair.first[0]
    for k in range(n):
        here = pair.second[k]
        before = pair.first[k]
        if here > 0.0:
            here = -before
    return here


@njit
def swapped(pair: Pair, n: int):
    """Set a structure again and again."""
    first, second = pair
    for _ in range(n):
        first, second = second, first
    return first[0] - second[0]


@njit
def owners(n: int):
    """Own arrays that are made in a loop, and let them go on several paths."""
    total = 0.0
    for k in range(n):
        pair = new_pair(k + 1)
        if k % 3 == 0:
            continue
        for i in range(k):
            total += pair.first[i] * (i + 1)
        if k % 3 == 1:
            row = pair.second
            total += row[0]
        elif total > 1e9:
            break
    return total


@njit
def owner_of_one_path(n: int):
    """Own arrays on one of two paths."""
    total = 1.0
    if n > 2:
        pair = new_pair(n)
        for i in range(n):
            total += pair.first[i]
        if total > 10.0:
            return total
        total += len(pair.second)
    return -total


@njit
def until(n: int):
    """Leave a loop with an array that the loop made."""
    k = 0
    while True:
        pair = new_pair(k + 2)
        k += 1
        if pair.first[k] > n:
            break
    return pair.first.sum() + pair.second.sum()


@njit
def returned(n: int):
    """Return an array that is also used on the way."""
    pair = new_pair(n)
    for i in range(n):
        pair.first[i] *= 2.0
    if n == 3:
        return pair.second
    return pair.first


@njit
def one_field(pair: Pair, n: int):
    total = 0.0
    for i in range(n):
        total += pair.second[i]
    return total


@njit
def of_many(many: Many, i: int):
    """Too long to be contained in callers."""
    total = 0.0
    for pair in (many.one, many.two, many.three, many.four, many.five, many.six):
        for k in range(i):
            total += pair.first[k] * pair.second[k]
            if total > 1e3:
                total = np.sqrt(total)
            elif total < -1e3:
                total = np.sin(total) + np.cos(total)
    return total


@njit
def passes_many_on(many: Many, i: int):
    return of_many(many, i) + of_many(many, i + 1) + of_many(many, i + 2)


@njit
def passed(many: Many, i: int):
    return passes_many_on(many, i)


@njit
def written(a, b):
    """Write an array to a part of another one."""
    a[1:, :] = b
    return a.sum()
'''
CALL = """
import json, resource, sys
import numpy as np
import example
from example import Many, Pair

texts, small = {}, {}
if not int(sys.argv[1]):
    from cnc.compiled import code_library
    finalize = code_library.KernelLibrary.finalize

    def recorded(library):
        texts.setdefault(library.kernel.name, str(library._final_module))
        finalize(library)
        if library.kernel.name not in small:
            small[library.kernel.name] = library.is_small

    code_library.KernelLibrary.finalize = recorded

random = np.random.default_rng(int(sys.argv[2]))
pair = Pair(random.normal(size=9), random.normal(size=9))
values = []
for n in range(9):
    values += [example.last(pair, n), example.swapped(pair, n), example.owners(n)]
    values += [example.owner_of_one_path(n), example.until(n), example.one_field(pair, n)]
    values += example.returned(n).tolist()
many = Many(*(Pair(random.normal(size=9), random.normal(size=9)) for _ in range(6)))
values.append(example.passed(many, 4))
values.append(example.written(random.normal(size=(3, 4)), random.normal(size=(2, 4))))
values.append(example.written(random.normal(size=(3, 4)), random.normal(size=4)))
try:
    example.written(np.ones((3, 4)), np.ones((3, 4)))
    values.append(0.0)
except ValueError:
    values.append(1.0)
for _ in range(200):
    example.owners(40)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
if not int(sys.argv[1]):
    for _ in range(30_000):  # a leak of one array each would take more than 30 MB
        example.owners(20), example.owner_of_one_path(200), example.until(10), example.returned(99)
grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
print(json.dumps([values, grown, texts, small]))
"""


@pytest.fixture(scope="module")
def called(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Any], list[Any]]:
    """What compiled kernels gave, and what plain Python gave."""
    folder = tmp_path_factory.mktemp("values")
    (folder / "example.py").write_text(KERNELS)
    path = os.pathsep.join((str(ROOT), str(folder)))
    environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder / "cache")}

    def run(disabled: str) -> list[Any]:
        done = subprocess.run(
            [sys.executable, "-c", CALL, disabled, "20261127"],
            capture_output=True,
            text=True,
            env=environment | {"NUMBA_DISABLE_JIT": disabled},
            check=False,
        )
        assert done.returncode == 0, done.stderr
        answer: list[Any] = json.loads(done.stdout)
        return answer

    return run("0"), run("1")


def test_values_on_all_paths_are_those_of_plain_python(
    called: tuple[list[Any], list[Any]],
) -> None:
    (values, *_), (expected, *_) = called
    assert values == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert values[-1] == 1.0  # shapes that differ are refused


def test_owners_let_arrays_go_on_all_paths(called: tuple[list[Any], list[Any]]) -> None:
    assert called[0][1] < 8 * 1024  # kB


def test_a_use_of_one_field_loads_no_structure(called: tuple[list[Any], list[Any]]) -> None:
    text = called[0][2]["one_field"]
    assert "load double" in text
    assert "load { {" not in text
    assert "insertvalue { {" not in text


def test_a_write_to_a_part_contains_no_functions_of_texts(
    called: tuple[list[Any], list[Any]],
) -> None:
    assert "unicode" not in called[0][2]["written"]


def test_a_kernel_that_passes_many_arguments_on_is_not_contained_in_its_callers(
    called: tuple[list[Any], list[Any]],
) -> None:
    assert not called[0][3]["passes_many_on"]
    assert called[0][3]["one_field"]


INNER = ir.LiteralStructType([ir.IntType(64), ir.ArrayType(ir.IntType(64), 2)])
OUTER = ir.LiteralStructType([INNER, ir.DoubleType()])


def _function() -> tuple[ir.Module, ir.IRBuilder, Any]:
    module = ir.Module()
    arguments = [OUTER, INNER, ir.IntType(64), ir.ArrayType(ir.IntType(64), 2)]
    function = ir.Function(module, ir.FunctionType(ir.IntType(64), arguments), "f")
    return module, ir.IRBuilder(function.append_basic_block()), function.args


def test_a_field_is_the_value_that_was_put_into_the_structure_last() -> None:
    from cnc.compiled.values import extracted

    _, builder, (outer, inner, number, row) = _function()
    whole = builder.insert_value(builder.insert_value(outer, inner, 0), number, (0, 0))
    assert extracted(builder, whole, (0, 0)) is number
    other = extracted(builder, whole, (0, 1))
    assert other.aggregate is inner
    assert tuple(other.indices) == (1,)
    assert extracted(builder, whole, (0, 1)) is other
    again = builder.insert_value(whole, inner, 0)
    assert extracted(builder, again, (0, 0)) is not number
    changed = builder.insert_value(builder.insert_value(again, row, (0, 1)), number, (0, 1, 1))
    assert extracted(builder, changed, (0, 1, 1)) is number
    assert extracted(builder, changed, (0, 1)).aggregate is changed  # made of two values
    part = extracted(builder, changed, (0, 1, 0))
    assert part.aggregate is row
    constant = ir.Constant(INNER, [ir.Constant(ir.IntType(64), 7), None])
    assert extracted(builder, constant, 0).constant == 7


def test_values_that_nothing_uses_are_left_out() -> None:
    from cnc.compiled.values import extracted, leave_out_unused

    module, builder, (outer, inner, number, _) = _function()
    place = builder.alloca(ir.IntType(64))
    builder.store(number, place)
    builder.load(place)
    whole = builder.insert_value(builder.insert_value(outer, inner, 0), number, (0, 0))
    used = extracted(builder, whole, (0, 1, 1))
    then = builder.function.append_basic_block()
    builder.branch(then)
    builder.position_at_end(then)
    both = builder.phi(ir.IntType(64))
    both.add_incoming(used, builder.function.blocks[0])
    builder.ret(both)
    leave_out_unused(module)
    text = str(module)
    assert "insertvalue" not in text
    assert "load" not in text
    assert text.count("extractvalue") == 1
    assert text.count("store") == 1

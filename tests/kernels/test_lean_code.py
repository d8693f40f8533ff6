"""Code without numba's detours: same values and errors, arguments in short, counts where needed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

from cnc.compiled import jit
from tests.support.paths import ROOT
from tests.support.soak import share

pytestmark = [
    pytest.mark.own_code,
    pytest.mark.skipif(not jit.compiling(), reason="kernels run as plain Python"),
]

KERNELS = '''
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit

RECORD = np.dtype([("place", np.float64), ("count", np.int32)])


class Inner(NamedTuple):
    grid: np.ndarray
    on: bool
    sizes: tuple[int, int]


class Outer(NamedTuple):
    inner: Inner
    line: np.ndarray
    records: np.ndarray
    factor: float


@njit
def element(a, i, j):
    return a[i, j]


@njit
def row_sum(a, i):
    row = a[i]
    total = 0.0
    for k in range(len(row)):
        total += (k + 1) * row[k]
    return total + row.size + row.ndim


@njit
def of_three(a, i: int, j: int, k: int):
    """Use a part of a part, a part, and an element."""
    plane = a[i]
    return plane[j, k] + 10.0 * a[i, j][k] + 100.0 * a[i, j, k] + plane.strides[0] + a.nbytes


@njit
def unsigned(a, i: int):
    return a[np.uint64(i)] + a[np.uint8(i)] + a[-1] + a[0]


@njit
def written(a, i: int, j: int):
    a[i, j] = 7.0
    a[j] = a[i]
    a[0, :2] = 3.0
    return a.sum() + a[i].max()


@njit
def filled(outer: Outer, work):
    """Use all that is passed inside of tuples, and write into an array of the caller."""
    inner, line, records, factor = outer
    total = factor * inner.sizes[1] + inner.sizes[0]
    for k in range(len(work)):
        work[k] = line[k % len(line)] * inner.grid[k % inner.grid.shape[0], -1]
        records[k % len(records)]["count"] += k
        total += records[k % len(records)]["place"]
    for k in range(len(line)):
        if line[k] > 1e6:
            total -= inner.grid[0, 0]
        elif line[k] < -1e6:
            total += inner.grid[0, 1]
        else:
            total += 0.5 * line[k]
    return total if inner.on else -total


@njit
def works(outer: Outer, n: int):
    """Own one array, and borrow all others."""
    work = np.empty(n)
    total = filled(outer, work)
    line = outer.line
    for k in range(n):
        line = outer.line if k % 2 else outer.inner.grid[0]
        total += work[k] + line[0]
    here = Outer(outer.inner, line, outer.records, 2.0)
    return total + here.line[1] + here.factor


@njit
def raises(a, n: int):
    """Make an array, whose size must not be negative."""
    b = np.ones(n)
    if n < 3:
        b[-1] = a[0]
    return b[-1]


@njit
def passes_on(a, n: int):
    return raises(a, n) + 1.0


@njit
def catches(a, n: int):
    try:
        return passes_on(a, n)
    except Exception:
        return -1.0


@njit
def kept(outer: Outer):
    """Return arrays of the argument, and one that is new."""
    new = outer.line + 1.0
    return outer.line, new, outer.inner.grid[1]
'''
CALL = """
import gc, json, sys
import numpy as np
import example
from example import Inner, Outer, RECORD

texts = {}
if not int(sys.argv[1]):
    from cnc.compiled import code_library
    add = code_library.KernelLibrary.add_ir_module

    def recorded(library, module):
        if library.kernel.name not in texts:
            texts[library.kernel.name] = str(module)
        add(library, module)

    code_library.KernelLibrary.add_ir_module = recorded

random = np.random.default_rng(int(sys.argv[2]))
values = []
for rows, columns in (1, 1), (1, 4), (5, 1), (3, 7):
    a = random.normal(size=(rows, columns))
    read_only = a.copy()
    read_only.flags.writeable = False
    every = random.normal(size=(2 * rows, 3 * columns))[::2, ::3]
    for each in a, np.asfortranarray(a), every, read_only, a[:, ::-1]:
        for i in range(-rows, rows):
            values.append(example.row_sum(each, i))
            values += [float(example.element(each, i, j)) for j in range(-columns, columns)]
b = random.normal(size=(3, 4, 5))
for i, j, k in random.integers((-3, -4, -5), (3, 4, 5), (20, 3)).tolist():
    values += [example.of_three(b, i, j, k), example.of_three(b[:, ::-1], i, j, k)]
values += [example.unsigned(random.normal(size=6), 4), example.row_sum(np.empty((2, 0)), 1)]
for shape in (2, 2), (4, 3):
    for order in "CF":
        values.append(example.written(np.array(random.normal(size=shape), order=order), 1, -2))
records = np.zeros(3, RECORD)
records["place"] = random.normal(size=3)
inner = Inner(random.normal(size=(2, 3)), True, (4, 5))
outer = Outer(inner, random.normal(size=4), records, 1.5)
for n in 1, 7:
    values.append(example.works(outer, n))
    values.append(example.works(outer._replace(inner=inner._replace(on=False)), n))
values += records["count"].tolist() + outer.line.tolist()
same, new, row = example.kept(outer)
values += same.tolist() + new.tolist() + row.tolist()
same[0] = 5.0  # the memory is that of the argument
values.append(outer.line[0])
errors = []
for n in 2, 3, -1:
    a = np.zeros(4)
    for kernel in example.raises, example.passes_on, example.catches:
        try:
            errors.append("inf" if kernel(a, n) != -1.0 else "caught")
        except ValueError:
            errors.append("ValueError")
counts = [sys.getrefcount(each) for each in (inner.grid, outer.line, records)]
for _ in range(50):
    example.works(outer, 4), example.kept(outer)
gc.collect()
same_counts = counts == [sys.getrefcount(each) for each in (inner.grid, outer.line, records)]
print(json.dumps([values, errors, same_counts, texts]))
"""


@pytest.fixture(scope="module", params=share([1, 20_261], [20_261]))
def called(
    tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest
) -> tuple[list[Any], list[Any]]:
    """What compiled kernels gave, and what plain Python gave."""
    folder = tmp_path_factory.mktemp("lean")
    (folder / "example.py").write_text(KERNELS)
    path = os.pathsep.join((str(ROOT), str(folder)))
    environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder / "cache")}

    def run(disabled: str) -> list[Any]:
        done = subprocess.run(
            [sys.executable, "-c", CALL, disabled, str(request.param)],
            capture_output=True,
            text=True,
            env=environment | {"NUMBA_DISABLE_JIT": disabled},
            check=True,
        )
        answer: list[Any] = json.loads(done.stdout)
        return answer

    return run("0"), run("1")


def test_values_are_those_of_plain_python(called: tuple[list[Any], list[Any]]) -> None:
    (values, *_), (expected, *_) = called
    assert len(values) > 500
    assert values == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_errors_reach_the_caller_and_a_try_catches_them(
    called: tuple[list[Any], list[Any]],
) -> None:
    (_, errors, *_), (_, expected, *_) = called
    assert errors == expected
    assert errors[6:] == ["ValueError", "ValueError", "caught"]


def test_arrays_of_the_caller_are_neither_kept_nor_freed(
    called: tuple[list[Any], list[Any]],
) -> None:
    assert called[0][2]


def test_only_the_array_that_a_kernel_makes_is_counted(
    called: tuple[list[Any], list[Any]],
) -> None:
    text = called[0][3]["works"]
    assert text.count('call void @"NRT_incref"') <= 1
    assert 1 <= text.count('call void @"NRT_decref"') <= 2


def test_an_array_is_passed_as_counts_data_and_shape(called: tuple[list[Any], list[Any]]) -> None:
    texts = called[0][3]
    # Result and error, then outer.inner (grid, on, sizes), line, records, factor, and work.
    assert _arguments(texts["filled"]) == 2 + (4 + 1 + 2) + 3 + 3 + 1 + 3
    # A part that is not contiguous has all fields: seven, with two sizes and two strides.
    assert _arguments(texts["element"]) == 2 + 4 + 2


def test_a_use_of_an_array_stores_none_of_its_fields(called: tuple[list[Any], list[Any]]) -> None:
    text = called[0][3]["element"]
    assert "extractvalue {i8*, i8*, i64, i64, double*" in text
    assert "alloca {i8*, i8*, i64, i64, double*" not in text


def _arguments(text: str) -> int:
    """Return the number of arguments of the function that a text defines."""
    head = next(line for line in text.splitlines() if line.startswith("define"))
    return head.count(' %"')

"""Arguments and results of loaded kernels: the same values as in plain Python, for all types."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cnc.compiled import jit
from cnc.compiled.kernel import kind, types_text
from tests.support.paths import ROOT
from tests.support.waiting import HANG

compiled = pytest.mark.skipif(not jit.compiling(), reason="kernels run as plain Python")

KERNELS = """
from typing import NamedTuple

import numpy as np

from cnc.compiled.jit import njit


class Pair(NamedTuple):
    first: np.ndarray
    second: float


@njit
def total(values):
    result = 0.0
    for value in values:
        result += value
    return result


@njit
def swapped(pair: Pair) -> Pair:
    return Pair(pair.first[::-1].copy(), -pair.second)


@njit
def with_record(rows):
    copy = rows.copy()
    copy[0]["n"] += 1
    return copy, rows[0]["x"] > 0.0


@njit
def filled(values, at, value):
    values[at] = value


@njit
def out_of_memory(n):
    return np.empty(n)
"""
CALLS = """
import json, sys
import numpy as np
import example

def tell(value):
    print(json.dumps(value))

rows = np.array([(1.5, 2), (2.5, 3)], dtype=[("x", "f8"), ("n", "i8")])
square = np.arange(12.0).reshape(3, 4)
tell([float(example.total(values)) for values in (
    square[0], square[:, 1], square[::-1, 2], np.arange(3, dtype=np.float32), np.arange(4),
    np.arange(4, dtype=np.uint8), np.zeros(0), (1.0, 2.0, 3.5))])
frozen = square[0].copy()
frozen.flags.writeable = False
tell(float(example.total(frozen)))
pair = example.swapped(example.Pair(square[1], 2.0))
tell([type(pair).__name__, pair.first.tolist(), pair.second])
pair = example.swapped(example.Pair(square[1], 2.0))
del square
tell(pair.first.tolist())
copy, positive = example.with_record(rows)
tell([copy["n"].tolist(), rows["n"].tolist(), bool(positive), copy.dtype == rows.dtype])
values = np.zeros(3)
example.filled(values, 1, 2.5)
example.filled(values, np.int64(2), np.float64(0.5))
tell(values.tolist())
try:
    example.out_of_memory(2**55)
except MemoryError:
    tell("MemoryError")
for wrong in ([1.0], {}, object()):
    try:
        example.out_of_memory(wrong)
    except TypeError as error:
        tell(str(error))
    else:
        tell("no error")
"""
WRONG = [f"kernels do not take a {name}" for name in ("list", "dict", "object")]


@pytest.mark.own_code
@compiled
def test_values_of_all_types_come_and_go_unchanged(tmp_path: Path) -> None:
    (tmp_path / "example.py").write_text(KERNELS)

    def outputs(**environment: str) -> list[Any]:
        done = subprocess.run(
            [sys.executable, "-c", CALLS],
            env=os.environ
            | {
                "PYTHONPATH": os.pathsep.join((str(ROOT), str(tmp_path))),
                "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
            }
            | environment,
            stdout=subprocess.PIPE,
            text=True,
            timeout=HANG,
            check=True,
        )
        return [json.loads(line) for line in done.stdout.splitlines()]

    in_python = outputs(NUMBA_DISABLE_JIT="1")[: -len(WRONG)]
    assert in_python[-1] == "MemoryError"
    assert outputs() == in_python + WRONG
    assert outputs() == in_python + WRONG  # from the files


class First(NamedTuple):
    values: np.ndarray
    number: float


class Second(NamedTuple):
    values: np.ndarray
    number: float


VALUES = np.arange(6.0)
RECORDS = np.zeros(2, dtype=[("x", "f8"), ("n", "i8")])
FROZEN = np.zeros(2)
FROZEN.flags.writeable = False
DIFFERENT = [
    VALUES,
    VALUES[::2],
    VALUES.reshape(2, 3),
    VALUES.reshape(2, 3).T,
    VALUES.reshape(2, 3)[:, ::2],
    VALUES.astype(np.float32),
    VALUES.astype(np.int64),
    VALUES.astype(bool),
    VALUES.astype(">f8"),
    FROZEN,
    RECORDS,
    RECORDS.astype([("x", "f8"), ("m", "i8")]),
    np.zeros(2, dtype=np.dtype([("x", "f8"), ("n", "i1")], align=True)),
    np.zeros(2, dtype=[("x", "f8"), ("n", "i1")]),
    1,
    1.0,
    True,
    None,
    "text",
    np.float32(1.0),
    np.int32(1),
    (1.0, 2.0),
    (1.0, 2),
    (1.0,),
    ((1.0,), 2.0),
    First(VALUES, 1.0),
    First(VALUES[::2], 1.0),
    Second(VALUES, 1.0),
]


def test_values_of_different_types_are_told_apart() -> None:
    assert len({types_text(kind(value)) for value in DIFFERENT}) == len(DIFFERENT)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (VALUES, np.zeros(0)),
        (VALUES, VALUES[2:5]),
        (VALUES.reshape(2, 3), VALUES.reshape(1, 6)),
        (VALUES, np.zeros(3).view(np.recarray)),
        (1, -(2**40)),
        (1, np.int64(7)),
        (1.0, np.float64(7.0)),
        (True, np.False_),
        (First(VALUES, 1.0), First(np.zeros(3), np.float64(2.0))),
    ],
)
def test_values_of_one_type_share_code(one: Any, other: Any) -> None:
    assert types_text(kind(one)) == types_text(kind(other))

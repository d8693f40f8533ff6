"""Kernels that only borrow arrays do not count references to them; all others do."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cnc.compiled import code_cache, jit
from cnc.compiled.loader import Code
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


@njit
def borrows(pair: Pair, low: int, high: int) -> float:
    """Take parts of arrays, with several ways out."""
    first, second = pair.first[low:high], pair.second[low:high]
    total = 0.0
    for k in range(high - low):
        if first[k] < 0.0:
            return -1.0
        if second[k] > 1e6:
            second = pair.first[low:high]
        total += first[k] * second[k]
    return total


@njit
def part_of(a, low: int):
    """Return a view of an array."""
    return a[low:]


@njit
def longer(a, more: int):
    """Return a new array."""
    out = np.zeros(len(a) + more)
    for k in range(len(a)):
        out[k] = a[k]
    return out


@njit
def exchanged(pair: Pair) -> Pair:
    """Return the same arrays in another order."""
    return Pair(pair.second, pair.first)


@njit
def mixed(pair: Pair, rounds: int) -> float:
    """Make arrays, and call kernels of every kind."""
    total = 0.0
    here = pair
    for k in range(rounds):
        here = exchanged(here)
        grown = longer(part_of(here.first, k % 3), 4)
        total += borrows(Pair(grown, here.second), 0, 5)
    return total + middle(here.first)


@njit
def middle(a) -> float:
    """Use a function of numba that makes an array and forgets it."""
    return np.median(a[1:])


@njit
def selected(a, places) -> float:
    """Select elements into a new array."""
    return a[places][0]
'''
CALL = """
import json, sys
import numpy as np
import example
from numba.core.runtime import _nrt_python as memory

memory.memsys_enable_stats()
pair = example.Pair(np.arange(9.0), np.arange(9.0) / 8.0 + 1.0)
names = ("borrows", "part_of", "longer", "exchanged", "mixed", "selected")
places = np.array([3, 1])

def results(kernels):
    borrows, part_of, longer, exchanged, mixed, selected = kernels
    other = exchanged(pair)
    return [
        borrows(pair, 1, 7), part_of(pair.first, 4).tolist(), longer(pair.second, 2).tolist(),
        other.first.tolist(), other.second.tolist(), mixed(pair, 50),
        selected(pair.first, places),
    ]

compiled = [getattr(example, name) for name in names]
found = results(compiled)
counts = [sys.getrefcount(each) for each in pair]
for _ in range(200):
    again = results(compiled)
print(json.dumps({
    "values": found == again,
    "counts": counts == [sys.getrefcount(each) for each in pair],
    "made": memory.memsys_get_stats_alloc(),
    "freed": memory.memsys_get_stats_free(),
    "found": found,
}))
"""


@pytest.fixture(scope="module")
def called(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """What the calls gave, and the folder of the compiled code."""
    folder = tmp_path_factory.mktemp("counts")
    (folder / "example.py").write_text(KERNELS)

    def run(**variables: str) -> dict[str, Any]:
        path = os.pathsep.join((str(ROOT), str(folder)))
        environment = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder / "cache")}
        done = subprocess.run(
            [sys.executable, "-c", CALL],
            capture_output=True,
            text=True,
            env=environment | variables,
            check=True,
        )
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer

    answer = run()
    answer["expected"] = run(NUMBA_DISABLE_JIT="1")["found"]
    return answer, folder / "cache"


def test_results_are_those_of_python_and_stay_so(called: tuple[dict[str, Any], Path]) -> None:
    answer, _ = called
    assert answer["found"] == answer["expected"]
    assert answer["values"]


def test_no_array_is_kept_or_freed_too_often(called: tuple[dict[str, Any], Path]) -> None:
    answer, _ = called
    assert answer["counts"]
    assert answer["made"] == answer["freed"] > 0


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("borrows", False),
        ("part_of", True),
        ("longer", True),
        ("exchanged", True),
        ("mixed", True),
        ("middle", True),
        ("selected", True),
    ],
)
def test_only_kernels_that_make_or_return_arrays_count(
    called: tuple[dict[str, Any], Path], name: str, counts: bool
) -> None:
    (file,) = called[1].glob(f"example-*/{name}-*.code")
    code = Code._make(
        pickle.loads(code_cache.read(called[1], str(file.relative_to(called[1]))) or b"")
    )
    assert (b"NRT_" in code.code) == counts

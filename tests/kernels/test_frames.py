"""Room on the interpreter's stack: deep calls take no memory from the system again and again."""

from __future__ import annotations

import sys

import pytest

from cnc.compiled.frames import with_room

resource = pytest.importorskip("resource")

DEEP = 400
"""Calls inside each other; some 20 chunks of the interpreter's stack."""
ROUNDS = 20


def _calls(depth: int) -> int:
    return 1 + _calls(depth - 1) if depth else 0


def _all_rounds(scale: int = 1, *, deep: int = DEEP) -> int:
    """Call so deeply, and return, again and again."""
    return sum(scale * _calls(deep) for _ in range(ROUNDS))


def _new_pages(function: object) -> int:
    """Return the number of pages of memory that a call takes from the system."""
    assert callable(function)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    function()
    return int(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)


@pytest.mark.skipif(
    sys.implementation.name != "cpython" or sys.gettrace() is not None,
    reason="the stack of other interpreters is another",
)
def test_deep_calls_take_their_memory_once() -> None:
    plain, roomy = _new_pages(_all_rounds), _new_pages(with_room(_all_rounds))
    assert plain > ROUNDS  # else there is nothing to gain with this interpreter
    assert roomy < plain / 3


def test_the_function_stays_the_same() -> None:
    roomy = with_room(_all_rounds)
    assert roomy(2, deep=3) == _all_rounds(2, deep=3) == 2 * 3 * ROUNDS
    assert roomy() == _all_rounds()
    assert (roomy.__name__, roomy.__doc__) == (_all_rounds.__name__, _all_rounds.__doc__)

    def with_variables(x: int) -> int:
        return x + len(text)

    text = "abc"
    assert with_room(with_variables)(1) == 4

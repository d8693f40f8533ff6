"""Random programs of the whole language: no traceback, no hang, no ignored word."""

from __future__ import annotations

import multiprocessing
import os
import random
import sys
import time
from typing import Any

import pytest

from cnc.gcode.core import interpreter
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.fuzz_checks import (
    Tally,
    check,
    check_message,
    check_seeds,
    every_word_matters,
    limited,
)
from tests.support.gcode.fuzzing import Author, Program
from tests.support.soak import share, soaking

XYZ = ("x", "y", "z")
SHARE = 2_000
"""Programs of one task of a process."""


def _share(number: int) -> Tally:
    return check_seeds(number * SHARE, SHARE, words_of=20)


@pytest.mark.timeout(7200)
def test_random_programs(capsys: pytest.CaptureFixture[str]) -> None:
    """A million programs in the soak, on all processors. An error names the seed of its program."""
    tally = Tally()
    began = time.perf_counter()
    if soaking():
        with multiprocessing.get_context("spawn").Pool(os.cpu_count()) as pool:
            for part in pool.imap_unordered(_share, range(1_000_000 // SHARE)):
                tally.add(part)
    else:
        tally.add(check_seeds(0, 400))
    rate = tally.programs / (time.perf_counter() - began)
    with capsys.disabled():
        sys.stdout.write(
            f"\n{tally.programs} programs, {rate:.0f}/s; {tally.accepted} accepted, {tally.words} "
            f"words changed; "
        )
        sys.stdout.write(f"{len(tally.codes)} kinds of error\n")
    assert tally.accepted > tally.programs * 0.05, "too few programs are accepted for a useful test"
    assert tally.words > tally.programs * 0.02


def test_random_bytes() -> None:
    rng = random.Random(7)
    for _ in range(share(20_000, 40)):
        below = [rng.choice([127, 0x250, 0xD800]) for _ in range(rng.randint(1, 60))]
        text = "".join(chr(rng.randrange(32, limit)) for limit in below) + rng.choice(
            ["", "\0", "\x1a", "\x7f"]
        )
        check(Program((text,), XYZ, rng.choice(["auto", "grbl", "fanuc"])))


# Tests of the checks


def test_equal_seeds_write_equal_programs() -> None:
    assert Author(5).program() == Author(5).program()
    assert Author(5).program() != Author(6).program()


def test_an_ignored_word_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = interpreter.Interpreter._in_order

    def careless(self: Any, words: Any, codes: Any) -> None:
        words.rest.pop("R", None)
        whole(self, words, codes)

    assert every_word_matters(Program(("G0 X1",), XYZ, "auto")) == 2
    monkeypatch.setattr(interpreter.Interpreter, "_in_order", careless)
    with pytest.raises(AssertionError):
        every_word_matters(Program(("G0 X1 R5",), XYZ, "auto"))


def test_a_hang_is_detected() -> None:
    def hang() -> None:
        with limited(0.05):
            while True:
                pass

    with pytest.raises(TimeoutError):
        hang()


@pytest.mark.parametrize(
    "message",
    [
        "unexpected Token",
        "got None",
        "X is nan",
        "expected __ANON_1",
        "KeyError",
        "at 0x7f: object at",
    ],
)
def test_internal_names_in_messages_are_detected(message: str) -> None:
    found = Diagnostic("some-code", "a message in plain words", "test.nc", 1, 1, 1, "G0")
    check_message(found, ("G0",))
    with pytest.raises(AssertionError):
        check_message(Diagnostic("some-code", message, "test.nc", 1, 1, 1, "G0"), ("G0",))

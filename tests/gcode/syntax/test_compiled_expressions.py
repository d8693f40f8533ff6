"""Compiled expressions against the grammar: equal values, bit for bit, or none."""

from __future__ import annotations

import math
import struct
from random import Random

import numpy as np
import pytest

from cnc.gcode.kernels import statements as kernel
from cnc.gcode.kernels.program import Parameters as Values
from cnc.gcode.kernels.program import evaluate
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.gcode.reader.source_text import Window, split
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.expression_cases import grow, spell
from tests.support.soak import share

KNOWN = {"1": 2.0, "2": -0.5, "3": 30.0, "30": 1e-7, "100": 1e5, "101": -3.0, "a": 0.25, "_g": 7.0}
SYNTAX = Syntax("ngc")


def by_grammar(line: str) -> float:
    """The value of the only word of a line; NaN if it has none."""
    known = Parameters()
    for key, value in KNOWN.items():
        if key.isdecimal():
            known.set_number(float(key), value, 1)
        else:
            known.set_name(key, value, 1)
    try:
        ((_, value_of),) = parse_line(line, SYNTAX).computed
        return value_of(known)
    except GcodeError:
        return math.nan


def compiled(text: str) -> float | None:
    """The value of an expression; None if compiled code leaves it to the interpreter."""
    data = f"S{text}\n".encode()
    window = Window(1, data, split(data, whole=True))
    coded = window.code()
    if coded.kind[0] == kernel.SIMPLE:
        return float(window.sorted.words.number[0])
    if coded.kind[0] != kernel.WORDS:
        return None
    numbered = np.zeros(kernel.LAST_PARAMETER + 1)
    for key, value in KNOWN.items():
        if key.isdecimal():
            numbered[int(key)] = value
    named = [KNOWN.get(name, math.nan) for name in window.names(coded.names)]
    slots = np.arange(len(data), dtype=np.int32)
    known = Values(numbered, np.array(named), slots)
    stack = np.zeros(kernel.MOST_VALUES)
    return evaluate(coded.code, int(coded.begin[0]), int(coded.end[0]), known, stack)


def bits(value: float) -> bytes:
    return b"none" if math.isnan(value) else struct.pack("<d", value)


@pytest.mark.timeout(3600)
def test_random_expressions_have_the_values_of_the_grammar() -> None:
    rng = Random(11)
    left = computed = 0
    amount = share(60_000, 400)
    for number in range(amount):
        tree = grow(rng, rng.randint(1, 5), macro=False)
        loose = number % 3 == 0
        text = f"[{spell(tree, rng, macro=False) if loose else spell(tree, macro=False)}]"
        found, wanted = compiled(text), by_grammar(f"S{text}")
        if found is None:
            # Blanks may stand inside numbers and words there.
            assert loose, text
            left += 1
        elif math.isnan(found):
            left += not math.isnan(wanted)
        else:
            assert bits(found) == bits(wanted), text
            computed += 1
    assert computed > amount / 3
    assert left < amount / 2


@pytest.mark.parametrize(
    "text",
    [
        "[1+2", "1]", "[]", "[1.2.3]", "--1", "[-+1]", "#-1", "#1.5", "#0", "#5001", "##0",
        "#<>", "#<a", "#<a(b>", "# <a b>", "#<_;>", "SINX[1]", "SI[1]", "ATAN[1]", "ATAN[1]/2",
        "SIN1", "[1 PLUS 2]", "[1**]", "[* 2]", "EXISTS[#1]", "[1 AND]", "X", "", "[1e5]", "é",
        "[(a)1]", "[" + "+".join("1" * 100) + "]",
        "#4999999999999999999",
    ],
)  # fmt: skip
def test_other_texts_are_left_to_the_grammar(text: str) -> None:
    found = compiled(text)
    assert found is None or math.isnan(found), text


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("[7 MOD -2]", 1.0), ("[-7 MOD 2]", 1.0), ("[-2**2]", 4.0), ("[2**3**2]", 64.0),
        ("[1+2*3]", 7.0), ("[10-4-3]", 3.0), ("-#1", -2.0), ("##1", -0.5), ("#[1+1]", -0.5),
        ("ATAN[1]/[-1]", 135.0), ("[1 EQ 1.0000001]", 1.0), ("[2 GT 1 AND 0 LT 1]", 1.0),
        ("ROUND[-2.5]", -3.0), ("FIX[-1.5]", -2.0), ("FUP[-1.5]", -1.0), ("SIN[30]", 0.5),
        ("COS[90]", 0.0), ("#<A>", 0.25), ("# 1", 2.0), ("[1 - -1]", 2.0),
        ("[1 2]", 12.0), ("[" * 70 + "1" + "]" * 70, 1.0),
    ],
)  # fmt: skip
def test_values(text: str, value: float) -> None:
    found = compiled(text)
    assert found is not None
    assert found == pytest.approx(value, abs=1e-15)

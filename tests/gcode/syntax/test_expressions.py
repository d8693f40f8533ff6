"""Expressions: values against an oracle and tables, and undefined values."""

from __future__ import annotations

import math
import struct
import time
import timeit
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.expression_cases import NoValue, Tree, grow, spell, worth
from tests.support.soak import share

NGC = Syntax("ngc")
MACRO = Syntax("macro-b", dialect="fanuc")
KNOWN = {"1": 2.0, "2": -0.5, "3": 30.0, "30": 1e-7, "100": 1e5, "101": -3.0, "a": 0.25, "_g": 7.0}


def parameters(*, macro: bool = False) -> Parameters:
    found = Parameters(macro=macro)
    for key, value in KNOWN.items():
        if key.isdecimal():
            found.set_number(float(key), value, 1)
        else:
            found.set_name(key, value, 1)
    return found


def value(text: str, syntax: Syntax = NGC, known: Parameters | None = None) -> float:
    """The value of the one computed word of a line."""
    ((index, compute),) = parse_line(text, syntax).computed
    assert index == 0
    return compute(known or parameters(macro=syntax is MACRO))


def bits(number: float) -> bytes:
    return struct.pack("<d", number)


@pytest.mark.parametrize("macro", [False, True])
def test_random_expressions_have_the_values_of_the_oracle(macro: bool) -> None:
    """Equal to the last bit, with spare brackets, blanks and any case; or both refuse."""
    rng = Random(5)
    syntax, known = MACRO if macro else NGC, parameters(macro=macro)
    amount, refused = share(60_000, 200), 0
    for _ in range(amount):
        tree = grow(rng, rng.randint(1, 5), macro=macro)
        plain = spell(tree, macro=macro)
        for text in (plain, spell(tree, rng, macro=macro)):
            try:
                wanted = worth(tree, KNOWN, macro=macro)
            except NoValue:
                refused += 1
                with pytest.raises(GcodeError):
                    value(f"S[{text}]", syntax, known)
            else:
                assert bits(value(f"S[{text}]", syntax, known)) == bits(wanted), text
    assert refused < amount, "most must have a value"


def full(tree: Tree) -> str:
    """The tree with all possible brackets."""
    inner = [full(part) for part in tree.parts]
    match tree.kind:
        case "number":
            return f"[{tree.text}]"
        case "parameter":
            return f"#{inner[0]}"
        case "name":
            return f"[#<{tree.text}>]"
        case "sign":
            return f"[{tree.text}[{inner[0]}]]"
        case "function":
            return f"[{tree.text}[{inner[0]}]]"
        case "atan":
            return f"[ATAN[{inner[0]}]/[{inner[1]}]]"
    return f"[{inner[0]} {tree.text} {inner[1]}]"


@given(st.integers(0, 2**32), st.integers(1, 4))
def test_minimal_brackets_parse_to_the_same_tree(seed: int, depth: int) -> None:
    tree = grow(Random(seed), depth)

    def outcome(text: str) -> object:
        try:
            return bits(value(text))
        except GcodeError as error:
            return error.diagnostic.code

    assert outcome(f"X[{spell(tree)}]") == outcome(f"X[{full(tree)}]")


NGC_TABLE = {
    # precedence, and from left to right
    "[-2**2]": 4, "[2**3**2]": 64, "[-[2]**2]": 4, "[-#1**2]": 4, "[2**-1]": 0.5, "[2*-1]": -2,
        "[2- -1]": 3, "[1-2-3]": -4,
    "[2/4*2]": 1, "[2+3*4]": 14, "[7 MOD 4*2]": 6, "[2*3**2]": 18, "[1+1 EQ 2]": 1,
        "[3 GT 2 EQ 1]": 1, "[1 LT 2 LT 3]": 1,
    "[1 EQ 1 AND 0]": 0, "[0 AND 1 OR 1]": 1, "[1 OR 1 AND 0]": 0, "[1 XOR 1 OR 1]": 1,
        "[2 GT 1 AND 3 GT 2]": 1,
    # operators
    "[5 MOD 3]": 2, "[-5 MOD 3]": 1, "[5 MOD -3]": 2, "[-5 MOD -3]": 1, "[-6 MOD 3]": 0,
        "[5.5 MOD 2.5]": 0.5, "[0**0]": 1,
    "[[-8]**3]": -512,
    "[2 AND -1]": 1, "[.0000001 AND 1]": 1, "[2 OR 0]": 1, "[2 XOR 3]": 0, "[0 XOR 3]": 1,
    # comparisons: EQ and NE to within a millionth, the others exact, as LinuxCNC makes them
    "[1 EQ 1.0000009]": 1, "[1 EQ 1.0000011]": 0, "[1 NE 1.0000009]": 0, "[1 NE 1.0000011]": 1,
        "[1 GE 1.0000009]": 0,
    "[1 GE 1.0000011]": 0, "[1 LE .9999991]": 0, "[1 LE .9999989]": 0,
    "[1 GT .9999995]": 1, "[1 LT 1.0000005]": 1, "[2 GE 2]": 1, "[2 LE 2]": 1, "[2 GT 2]": 0,
        "[2 LT 2]": 0,
    # functions
    "[FIX[2.8]]": 2, "[FIX[-2.8]]": -3, "[FUP[2.2]]": 3, "[FUP[-2.8]]": -2, "[ROUND[2.5]]": 3,
        "[ROUND[-2.5]]": -3, "[ROUND[-.4]]": 0,
    "[ROUND[.49999999999999994]]": 0, "[ABS[-3]]": 3, "[SIN[30]*2]": pytest.approx(1),
        "[SIN[180]]": 0, "[COS[90]]": 0,
    "[TAN[45]]": pytest.approx(1),
    "[ASIN[1]]": 90, "[ACOS[-1]]": 180, "[ATAN[1]/[1]]": 45, "[ATAN[1]/[-1]]": 135,
        "[ATAN[-1]/[-1]]": -135, "[ATAN[0]/[0]]": 0,
    "[EXP[1]]": math.e, "[LN[EXP[2]]]": 2, "[SQRT[16]]": 4, "SQRT[16]": 4, "-SQRT[16]": -4,
        "ATAN[1]/[0]": 90,
    # parameters
    "#1": 2, "-#1": -2, "##1": -0.5, "#[#1+1]": 30, "#[1.00001]": 2, "#100": 1e5, "#<a>": 0.25,
        "#<A>": 0.25, "#< _ G >": 7, "#500": 0,
    "#5220": 1,
    "EXISTS[#<a>]": 1, "EXISTS[#<c>]": 0, "EXISTS[#1]": 1, "EXISTS[#31]": 1, "EXISTS[#5602]": 1,
        "EXISTS[#5603]": 0, "EXISTS[#[#1-2]]": 0,
    # numbers and blanks
    "[.5]": 0.5, "[5.]": 5, "[1 2 . 5 ]": 12.5, "[s i n [ 9 0 ]]": 1,
        "[a\tt a n [ 1 ] / [ 1 ]]": 45, "[+5]": 5, "[1 A N D 1]": 1,
    "[1 2]": 12,
}  # fmt: skip
MACRO_TABLE = {
    # precedence: * / MOD AND, then + - OR XOR, then comparisons
    "[1+2*3]": 7, "[1 OR 2 AND 2]": 3, "[4 XOR 1+1]": 6, "[7 MOD 4*2]": 6, "[1+1 EQ 2]": 1,
        "[[1 EQ 1] AND [2 EQ 2]]": 1, "[12 AND 10]": 8,
    "[12 OR 10]": 14, "[12 XOR 10]": 6, "[2.6 AND 3]": 3,
    # MOD of whole numbers, with the sign of the first
    "[7 MOD 4]": 3, "[-7 MOD 4]": -3, "[7 MOD -4]": 3, "[7.4 MOD 3.6]": 3,
    # toward zero and away from it
    "[FIX[1.2]]": 1, "[FIX[-1.2]]": -1, "[FUP[1.2]]": 2, "[FUP[-1.2]]": -2, "[0+ROUND[1.5]]": 1.5,
        "[RND[-1.2346]]": -1.235,
    # angles from 0 to 360, arctangent of one argument from -90 to 90
    "[ATAN[-1]/[-1]]": 225, "[ATAN[1]/[-1]]": 135, "[ATAN[-1]/[1]]": 315, "[ATAN[-1]]": -45,
        "[ATN[1]]": 45, "[ASIN[-1]]": 270,
    "[ASIN[1]]": 90, "[ACOS[-1]]": 180,
    "[SQR[16]]": 4, "[SQRT[16]]": 4, "[BIN[18]]": 12, "[BCD[12]]": 18, "[BCD[BIN[4660]]]": 4660,
    # exact comparison
    "[1 EQ 1.0000001]": 0, "[1 GE 1.0000001]": 0, "[1 LE .9999999]": 0, "[1 NE 1.0000001]": 1,
    # vacant variables: 0 in what is computed, themselves in EQ and NE
    "[#5 EQ #0]": 1, "[#5 NE #0]": 0, "[#5 EQ 0]": 0, "[#5 NE 0]": 1, "[#1 EQ #0]": 0,
        "[#5 GE 0]": 1, "[#5 GT 0]": 0, "[#5 LE #0]": 1,
    "[#5+1]": 1,
    "[#5*#0]": 0, "[ABS[#5]]": 0, "[[#5] EQ [#0]]": 1, "[#[#5] EQ #0]": 1, "[#150 EQ #0]": 1,
        "[#5261+0]": 0,
}  # fmt: skip


@pytest.mark.parametrize(("text", "wanted"), NGC_TABLE.items())
def test_values(text: str, wanted: float) -> None:
    assert value("X" + text) == wanted


@pytest.mark.parametrize(("text", "wanted"), MACRO_TABLE.items())
def test_values_in_macro_b(text: str, wanted: float) -> None:
    assert value("X" + text, MACRO) == pytest.approx(wanted, rel=1e-15, abs=0)


@pytest.mark.parametrize("text", ["X#5", "X-#5", "X[#5]", "X[-#0]", "X#0", "X##5"])
def test_a_vacant_word_is_nan(text: str) -> None:
    assert math.isnan(value(text, MACRO))


def test_an_assignment_keeps_a_vacant_value() -> None:
    known = parameters(macro=True)
    (assignment,) = parse_line("#6=#5", MACRO).assignments
    assert math.isnan(assignment.value(known))
    (assignment,) = parse_line("#6=#5+0", MACRO).assignments
    assert assignment.value(known) == 0


def test_round_uses_the_least_input_increment_in_words_only() -> None:
    """FANUC: #1=1.2345; X[ROUND[#1]] moves to 1.235 (0.001 mm), #2=ROUND[#1] is 1."""
    known = parameters(macro=True)
    known.set_number(1, 1.2345, 1)
    assert value("X[ROUND[#1]]", MACRO, known) == 1.235
    assert value("S[ROUND[#1]]", MACRO, known) == 1
    known.increments = 10_000.0
    assert value("X[ROUND[#1]]", MACRO, known) == 1.2345
    (assignment,) = parse_line("#2=ROUND[#1]", MACRO).assignments
    assert assignment.value(known) == 1


FAULTS = [
    ("division-by-zero", "X[1 ¦/ 0]", NGC),
    ("division-by-zero", "X[#1 + 4 ¦/ [#1 - 2]]", NGC),
    ("division-by-zero", "X[5 ¦MOD 0]", NGC),
    ("division-by-zero", "X[5 ¦MOD .4]", MACRO),
    ("power-undefined", "X[0 ¦** -1]", NGC),
    ("power-undefined", "X[-8 ¦** .333]", NGC),
    ("argument-out-of-range", "X[¦SQRT[-1]]", NGC),
    ("argument-out-of-range", "X¦SQR[-1]", MACRO),
    ("argument-out-of-range", "X¦LN[0]", NGC),
    ("argument-out-of-range", "X¦LN[-1]", NGC),
    ("argument-out-of-range", "X[¦ASIN[1.0000001]]", NGC),
    ("argument-out-of-range", "X[¦ACOS[-1.0000001]]", NGC),
    ("argument-out-of-range", "X[1 + ¦TAN[90]]", NGC),
    ("argument-out-of-range", "X¦TAN[-270]", NGC),
    ("argument-out-of-range", "X¦BIN[26]", MACRO),
    ("argument-out-of-range", "X¦BCD[-1]", MACRO),
    ("argument-out-of-range", "X¦BCD[100000000]", MACRO),
    ("number-too-large", "X¦EXP[1000]", NGC),
    ("number-too-large", "X[10 ¦** 400]", NGC),
    ("number-too-large", "X[#100 ** 50 ¦* [#100 ** 50]]", NGC),
    ("number-too-large", "X[9 * 10 ** 307 ¦+ [10 ** 308]]", NGC),
    ("number-too-large", "X[-9 * 10 ** 307 ¦- [10 ** 308]]", NGC),
    ("number-too-large", "X[1 ¦/ [10 ** -320]]", NGC),
    ("parameter-number", "X¦#[#2]", NGC),
    ("parameter-number", "X¦#0", NGC),
    ("parameter-number", "X[1 + ¦#5603]", NGC),
    ("parameter-number", "X¦#[#101]", NGC),
    ("parameter-number", "X¦#34", MACRO),
    ("parameter-number", "X¦#1000", MACRO),
    ("parameter-number", "X¦##101", MACRO),
    ("parameter-undefined", "X[1 + ¦#<c>]", NGC),
    ("parameter-undefined", "X¦#<_c>", NGC),
]


@pytest.mark.parametrize(("code", "marked", "syntax"), FAULTS)
def test_undefined_values_are_errors(code: str, marked: str, syntax: Syntax) -> None:
    """The line is parsed; the error is raised whenever the value is computed."""
    text = marked.replace("¦", "")
    ((_, compute),) = parse_line(text, syntax).computed
    known = parameters(macro=syntax is MACRO)
    for _ in range(2):
        with pytest.raises(GcodeError) as caught:
            compute(known)
        found = caught.value.diagnostic
        assert (found.code, found.column) == (code, marked.index("¦") + 1), found


def test_the_error_of_an_unset_name_has_a_hint() -> None:
    with pytest.raises(GcodeError) as caught:
        value("X#<aa>")
    assert "did you mean #<a>?" in caught.value.diagnostic.hint


def test_computing_a_line_is_fast() -> None:
    """The limit is ten times the usual time, so that only a mistake exceeds it.

    In seconds of the processor: other processes of a busy computer do not count.
    """
    computes = [compute for _, compute in parse_line("G1 X[#1*0.5+2] Y[SIN[#2]*10]", NGC).computed]
    known = parameters()
    timer = timeit.Timer(lambda: [compute(known) for compute in computes], timer=time.process_time)
    assert min(timer.repeat(number=1000, repeat=5)) < 0.015

"""Lines with syntax errors, with the code and column of the error.

The mark ¦ stands before the faulty part. It is removed before the line is parsed.
"""

from __future__ import annotations

import contextlib
import random

import pytest

from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.soak import share
from tests.support.work import at_most

NGC = Syntax("ngc", siemens=True, dialect="linuxcnc")
MACRO = Syntax("macro-b", dialect="fanuc")
NONE = Syntax("none", dollar=True, dialect="grbl")


def refused(text: str, syntax: Syntax) -> Diagnostic:
    with pytest.raises(GcodeError) as caught:
        parse_line(text, syntax)
    return caught.value.diagnostic


NGC_CASES = [
    # brackets
    ("bracket-not-closed", "G1 X¦[1+2", "]"),
    ("bracket-not-closed", "G1 X¦[SIN[30] Y5", "before Y"),
    ("bracket-not-closed", "X[¦[[1]", "]"),
    ("bracket-not-closed", "X1 Y¦[2 Z3", "before Z"),
    ("bracket-not-closed", "X¦[1+2 ; note", "]"),
    ("bracket-not-closed", "o100 call ¦[1", "]"),
    ("bracket-not-open", "G1 X[1+2]¦] Y1", ""),
    ("bracket-not-open", "¦]", ""),
    ("bracket-missing", "X ¦SIN 30", "SIN[..]"),
    ("bracket-missing", "X[¦SIN 30]", "SIN[..]"),
    ("bracket-missing", "X[¦SIN(30)]", "comment"),
    ("bracket-missing", "X[ATAN[1]¦/2]", "ATAN[y]/[x]"),
    ("bracket-missing", "o100 ¦if #1 eq 2", "IF[..]"),
    ("bracket-missing", "o100 ¦if", "IF[..]"),
    ("bracket-missing", "o100 ¦repeat 5", "REPEAT[..]"),
    ("bracket-missing", "o100 call ¦1 2", "call [1] [2]"),
    ("bracket-missing", "o100 call [1] ¦#2", "call [1] [2]"),
    ("bracket-missing", "o100 return ¦5", ""),
    ("bracket-missing", "X[¦EXISTS #1]", "EXISTS[..]"),
    # values
    ("value-missing", "X[1¦+]", ""),
    ("value-missing", "X¦[*2]", ""),
    ("value-missing", "X[1¦+*2]", ""),
    ("value-missing", "X¦[]", ""),
    ("value-missing", "X[2 ¦MOD]", ""),
    ("value-missing", "X¦[MOD 2]", ""),
    ("value-missing", "X[#1 ¦EQ ]", ""),
    ("value-missing", "X[1 ¦OR", ""),
    ("value-missing", "X[2-¦-]", ""),
    ("value-missing", "X[¦-]", ""),
    ("value-missing", "#1¦=", ""),
    ("value-missing", "#[1¦+]=3", ""),
    ("value-missing", "¦SD=", ""),
    ("value-unknown", "X[¦Y+1]", "#<y>"),
    ("value-unknown", "X[#1+¦foo]", "#<foo>"),
    ("value-unknown", "#1=¦X3", "#<x>"),
    ("number-malformed", "X[1 2.5¦.1]", ""),
    ("number-malformed", "X1.2¦.3", ""),
    ("number-malformed", "X[¦--2]", ""),
    ("number-malformed", "¦X - + 2", ""),
    ("number-missing", "X[1] ¦Y", "Y10"),
    ("number-missing", "¦X(1+2)", "[ ]"),
    ("number-missing", "¦SD3", "SD=3"),
    # functions and operators
    ("function-unknown", "X[¦FOO[1]]", ""),
    ("function-unknown", "X[¦SQT[4]]", "SQRT"),
    ("function-unknown", "X¦SQT[4]", "SQRT"),
    ("function-unknown", "X[¦SINN[30]]", "SIN"),
    ("function-unknown", "X¦COSS[30]", "COS"),
    ("operator-missing", "X[#1¦#2]", ""),
    ("operator-missing", "X[1¦[2]]", ""),
    ("operator-missing", "X[SIN[1]¦COS[1]]", ""),
    ("operator-missing", "X[[1]¦2]", ""),
    ("operator-unknown", "X[1 ¦ANDD 2]", "AND"),
    ("operator-unknown", "X[#1 ¦GTE 2]", "GT"),
    ("operator-unknown", "X[1 ¦X 2]", ""),
    ("operator-unknown", "X[1¦e5]", "10**3"),
    ("operator-unknown", "X[1 ¦^ 2]", "**"),
    ("operator-unknown", "X[5 ¦% 2]", "MOD"),
    ("operator-unknown", "X[1 ¦&& 2]", "AND"),
    ("operator-unknown", "X[#1 ¦< 2]", "LT"),
    ("operator-unknown", "X[#1 ¦>= 2]", "GT"),
    ("equals-place", "X[1 ¦= 2]", "EQ"),
    ("equals-place", "o100 if [#1 ¦= 2]", "EQ"),
    ("equals-place", "#1=¦=3", "EQ"),
    ("equals-place", "X¦=5", "without ="),
    ("equals-place", "¦=5", "#1=5"),
    ("arctangent-second", "X[ATAN[1]¦]", "ATAN[y]/[x]"),
    ("exists-parameter", "X[EXISTS¦[1]]", "#<name>"),
    ("character-unknown", "X[1¦,5]", ""),
    ("character-unknown", "X[1 ¦? 2]", ""),
    ("expression-without-brackets", "#1=#2¦+3", "[ ]"),
    ("expression-without-brackets", "X#1 ¦- 2", "[ ]"),
    ("expression-without-brackets", "X[1]¦*2", "[ ]"),
    ("expression-without-brackets", "X5¦/2", "[ ]"),
    ("letter-missing", "¦1=5", "#1=5"),
    ("letter-missing", "¦[1+2]", "letter"),
    ("letter-missing", "X[1] ¦[2]", ""),
    ("letter-missing", "¦EXISTS[#1]", ""),
    # parameters
    ("parameter-number-missing", "X¦#", "#100"),
    ("parameter-number-missing", "X¦#foo", "#<foo>"),
    ("parameter-number-missing", "¦#=5", ""),
    ("parameter-number-missing", "#¦#=3", ""),
    ("parameter-number", "X#¦1.5", ""),
    ("name-not-closed", "X¦#<foo", ">"),
    ("name-not-closed", "¦O<foo", ">"),
    ("name-empty", "X¦#<>", ""),
    ("name-empty", "¦O<> call", ""),
    ("assignment-missing", "¦#1", "#1=5"),
    ("assignment-missing", "¦#<a> G0", "#<a>=5"),
    ("assignment-missing", "¦#1+2", "#1=5"),
    # comments
    ("comment-place", "X[1+¦(2)]", "[ ]"),
    ("comment-place", "X[1+2 ¦(note)", ""),
    ("comment-not-closed", "G1 X1 ¦(a ; b", ")"),
    ("comment-not-open", "X[¦)]", ""),
    # O-words
    ("label-missing", "¦O", "o100"),
    ("label-missing", "¦O sub", "o100"),
    ("label-missing", "¦sub", "o100 sub"),
    ("label-missing", "¦call [1]", "o100 call"),
    ("label-malformed", "O¦100.5 sub", "whole"),
    ("keyword-unknown", "o100 ¦wile [1]", "WHILE"),
    ("keyword-unknown", "o<foo> ¦cal", "CALL"),
    ("keyword-unknown", "o100 ¦iff [1]", "IF"),
    ("keyword-unknown", "¦BSPLIN SD=3", "BSPLINE"),
    ("keyword-missing", "o100 ¦G0 X1", "while"),
    ("keyword-missing", "o100 ¦[1]", "while"),
    ("text-after-control", "o100 sub ¦G0", "next line"),
    ("text-after-control", "o100 if [#1 eq 2] ¦G0 X1", "next line"),
    ("bracket-missing", "o<a> call [1] (x) ¦#2", ""),
    ("control-not-alone", "¦G0 o100 sub", "another line"),
    ("control-not-alone", "N5 ¦G0 o100 call", "another line"),
    ("control-not-alone", "¦#1=2 o100 sub", "another line"),
    ("line-number-bad", "¦N-1.5 o100 call", ""),
    ("syntax-not-in-dialect", "¦if [#1 eq 2]", "fanuc"),
    ("syntax-not-in-dialect", "¦GOTO 10", "fanuc"),
    ("syntax-not-in-dialect", " ¦$H", "grbl"),
    # the rest
    ("percent-place", "% ¦G0", ""),
    ("block-delete-place", "/ ¦/X1", ""),
    ("number-too-large", "#1=¦" + "9" * 400, ""),
]

MACRO_CASES = [
    ("keyword-missing", "IF[#1EQ2¦]", ""),
    ("keyword-missing", "IF[#1EQ2] ¦G0X1", ""),
    ("keyword-missing", "IF[#1EQ2] ¦#1=5", ""),
    ("keyword-missing", "IF[#1EQ2] ¦5", ""),
    ("keyword-missing", "IF[#1EQ2] ¦GOT 10", "GOTO"),
    ("keyword-missing", "WHILE[#1LT2¦]", ""),
    ("keyword-unknown", "¦WHLE[#1LT2]DO1", "WHILE"),
    ("keyword-unknown", "¦IFF[#1EQ2]GOTO10", "IF"),
    ("keyword-unknown", "¦GOT10", "GOTO"),
    ("keyword-unknown", "¦ENDD1", "END"),
    ("keyword-place", "¦THEN#1=5", "IF"),
    ("bracket-missing", "¦IF #1 EQ 2 GOTO 10", "IF[..]"),
    ("bracket-missing", "#1=¦SIN 3", "SIN[..]"),
    ("bracket-not-closed", "#1=¦[#2+3", "]"),
    ("equals-place", "IF[#1¦=2]GOTO10", "EQ"),
    ("number-missing", "¦GOTO", "GOTO 1"),
    ("number-missing", "WHILE[#1LT2]¦DO", "DO 1"),
    ("number-missing", "¦END", "END 1"),
    ("label-malformed", "DO¦1.5", ""),
    ("label-missing", "¦O", "O1234"),
    ("text-after-control", "O1234 ¦G0", ""),
    ("syntax-not-in-dialect", "¦O1234 sub", "FANUC has IF"),
    ("text-after-control", "END1 ¦X3", ""),
    ("expression-without-brackets", "GOTO #1¦+1", "[#1+10]"),
    ("expression-without-brackets", "X#1¦+2", "[ ]"),
    ("value-missing", "#1=#2¦+", ""),
    ("value-missing", "#1¦=", ""),
    ("operator-unknown", "#1=#2¦**2", ""),
    ("operator-unknown", "#1=#2 ¦ANDD 3", "AND"),
    ("function-unknown", "#1=¦SINN[3]", "SIN"),
    ("function-unknown", "#1=¦EXISTS[#3]", ""),
    ("syntax-not-in-dialect", "#1=¦#<foo>", ""),
    ("text-after-control", "O<foo> ¦call", ""),
    ("assignment-missing", "IF[#1EQ2]¦THEN", "THEN #1=5"),
    ("assignment-missing", "IF[#1EQ2]THEN ¦#1", "#1=5"),
    ("assignment-missing", "¦#1", "#1=5"),
    ("control-not-alone", "¦G0 IF[#1EQ2]GOTO10", ""),
    ("character-unknown", "X1¦,Q5", ""),
]

NONE_CASES = [
    ("syntax-not-in-dialect", "X¦[1]", ""),
    ("syntax-not-in-dialect", "X¦#1", ""),
    ("syntax-not-in-dialect", "¦#1=5", ""),
    ("syntax-not-in-dialect", "¦o100 sub", ""),
    ("syntax-not-in-dialect", "(O[#) X¦[1]", ""),
    ("syntax-not-in-dialect", "¦BSPLINE", ""),
    ("syntax-not-in-dialect", "¦SD=3", ""),
]

CASES = [
    (*case, syntax)
    for table, syntax in ((NGC_CASES, NGC), (MACRO_CASES, MACRO), (NONE_CASES, NONE))
    for case in table
]


@pytest.mark.parametrize(
    ("code", "marked", "hint", "syntax"),
    CASES,
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_error_has_its_code_and_place(
    code: str, marked: str, hint: str, syntax: Syntax
) -> None:
    text = marked.replace("¦", "")
    column = marked.index("¦") + 1
    found = refused(text, syntax)
    assert (found.code, found.column) == (code, column), found
    assert 1 <= found.length <= len(text) - column + 1
    assert hint in found.hint
    assert found.message
    assert "token" not in found.message.lower()


def test_the_table_has_enough_cases() -> None:
    assert len(CASES) >= 150


@pytest.mark.parametrize("syntax", [NGC, MACRO])
def test_blanks_and_case_do_not_move_the_error(syntax: Syntax) -> None:
    for code, marked, _, flavour in CASES:
        if flavour is syntax and "¦" in marked and "(" not in marked:
            spread = " ".join(marked.replace(" ", "")).swapcase().replace("¦ ", "¦")
            found = refused(spread.replace("¦", ""), syntax)
            assert (found.code, found.column) == (code, spread.index("¦") + 1), spread


PIECES = [
    "#", "#1", "#<a>", "#<", "[", "]", "(", ")", "(c)", ";", "=", "+", "-", "*", "**", "/", "MOD",
        "EQ", "AND", "SIN", "SIN[", "ATAN",
    "EXISTS", "1", "2.5", ".", "X", "G1", "N5", "O", "o100", "o<a>", "sub", "call", "if", "while",
        "do", "return", "IF", "GOTO", "THEN",
    "WHILE", "DO", "END", "BSPLINE", "SD=", "%", "$", "\u00e9", "<", ">", ",", "E", "FOO", " ",
]  # fmt: skip


@pytest.mark.parametrize("syntax", [NGC, MACRO, NONE])
def test_random_lines_are_parsed_or_refused_with_a_message(syntax: Syntax) -> None:
    rng = random.Random(11)
    for _ in range(share(50_000, 200)):
        text = "".join(rng.choice(PIECES) for _ in range(rng.randint(1, 8)))
        try:
            parse_line.__wrapped__(text, syntax)
        except GcodeError as error:
            found = error.diagnostic
            assert 1 <= found.column < found.column + found.length <= len(text) + 1, text
            assert found.message and "token" not in found.message.lower()


NESTED = [
    "X" + "[" * 2000,
    "X" + "[" * 1000 + "1" + "]" * 1000,
    "X[" + "-[" * 650 + "1",
    "#" * 2000 + "1",
    "X[1" + "+1" * 1000 + "]",
    "X[#1" + "+#1" * 650 + "]",
    "X" + "SIN[" * 400 + "1" + "]" * 400,
    "X[" + "#[" * 650 + "1" + "]" * 650 + "]",
    "X" + "SIN[" * 400 + "#1" + "]" * 400,
    "o100 call" + "[1]" * 650,
]


@pytest.mark.parametrize("text", NESTED[:: share(1, 3)], ids=lambda text: text[:20])
@pytest.mark.parametrize("syntax", [NGC, MACRO])
def test_the_work_of_deep_nesting_grows_with_the_length(text: str, syntax: Syntax) -> None:
    with contextlib.suppress(GcodeError), at_most(calls=200 * len(text)):
        parse_line(text, syntax)


def test_expressions_have_any_depth() -> None:
    depth = 1000
    ((_, value),) = parse_line("X[" + "[" * depth + "#1" + "+1]" * depth + "]", NGC).computed
    assert value(Parameters({})) == depth

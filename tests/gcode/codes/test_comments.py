"""Parameter values in comments.

The expected texts are LinuxCNC's, or its manual's where they differ.
"""

from __future__ import annotations

import pytest

from cnc.gcode.core.comments import fill
from cnc.gcode.core.program import interpret
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Abort, Polyline, WaitInput
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.gcode.gcode_cases import error_of, run

CASES = {
    "hello #1 end": "hello 1.234568 end",
    "#1#2": "1.234568-7.600000",
    "%d #1 %f #1": " 1  1.2346",
    "%.2f#1": "1.23",
    "%d#1 #2 %f #2": "1 -8  -7.6000",
    "%.3f #1 #1": " 1.235 1.235",
    "%.0f #1 %.4f #2 #<_g>": " 1  -7.6000 1000.0000",
    "#<ab>x #<_G> #<a b>": "3.500000x 1000.000000 3.500000",
    "## #x #<nope> #9999 #[1+1] ##1": "## #x ###### ###### #[1+1] #1.234568",
    "%%d % %x %5.2f #1": "% % %x %5.2f 1",
    "a#1b #2.": "a1.234568b -7.600000.",
    "%.15f#1": "%.15f1.234568",
    "%lf #1": "%lf 1.234568",
    "#<> #0 #99999999999999999999": "###### ###### ######",
    "": "",
}


def known(*, macro: bool = False) -> Parameters:
    parameters = Parameters(macro=macro)
    parameters.set_number(1, 1.23456789, 1)
    parameters.set_number(2, -7.6, 1)
    parameters.set_name("ab", 3.5, 1)
    parameters.set_name("_g", 1000.0, 1)
    return parameters


@pytest.mark.parametrize(("text", "wanted"), CASES.items())
def test_values_in_a_comment(text: str, wanted: str) -> None:
    assert fill(text, known()) == wanted


def test_a_vacant_variable() -> None:
    assert fill("#5", known(macro=True)) == "######"


def test_comments_of_a_program() -> None:
    """Those of a line come after its assignments and before its moves; MSG is not filled."""
    source = (
        "#1=2.5\n#1=[#1*2] (debug, is %.1f#1) G0 X#1\n(print,#<_x> %d#5420)\n(msg, #1)\n(note #1)"
    )
    assert [block.text for block in run(source) if hasattr(block, "text")] == [
        "is 5.0",
        "2.500000 2",
        "#1",
    ]


@pytest.mark.parametrize("word", ["MSG", "N10 LogMsg", "warnmsg"])
def test_a_message_of_edingcnc(word: str) -> None:
    """Its manual has the text in quotes behind MSG; LinuxCNC has no such line."""
    source = f'{word} "Tool: #11 D4.0 G0 X5" ; note\nG0 X1'
    texts = [block.text for block in run(source) if hasattr(block, "text")]
    assert texts == ["Tool: #11 D4.0 G0 X5"]
    assert error_of(f"{source}\nM2", dialect="linuxcnc").code == "number-missing"
    assert error_of(f'{word} "Tool" G0 X5\nM2').line == 1


def test_an_abort_reports_its_text() -> None:
    found = error_of("#1=2.5\nG0 X1\nG1 Y2 F60 (Abort , tool %d#1 at #<_x> is #<gone>)")
    assert found.message == "the program aborts itself: tool 2 at 1 is ######"
    assert (found.line, found.column, found.length) == (3, 11, 39)
    assert error_of("(ABORT,)").message == "the program aborts itself"
    assert error_of("/(ABORT, now)").code == "program-abort"
    assert run("/(ABORT, now)", block_delete=True) == []


def test_the_moves_before_an_abort_are_made() -> None:
    blocks = interpret(
        Text.of_lines(["F60", "G41.1 D2", "G1 X10", "X20", "(ABORT, now) X30"], "test.nc")
    )
    moves = next(blocks)
    assert isinstance(moves, Polyline)
    assert moves.points.round(9).tolist() == [[10.0, 1.0, 0.0], [20.0, 1.0, 0.0]]
    assert next(blocks) == Abort("test.nc", 5)
    with pytest.raises(GcodeError, match="program-abort"):
        next(blocks)


ASKED = (
    "M66 P1 L0\no1 while [#1 LT 3]\n#1=[#1+1]\no2 if [#5399 EQ {}]\n(ABORT, input %d#5399)\n"
    "o2 endif\no1 endwhile\nG0 X1"
)


def test_an_assumed_answer_does_not_abort() -> None:
    """What is read goes on, so that the lines behind are looked at too; the warning comes once."""
    reported: list[Diagnostic] = []
    blocks = run(ASKED.format(0), warn=reported.append)
    assert [type(block) for block in blocks] == [WaitInput, Polyline]
    assert [(found.code, found.severity, found.line, found.column) for found in reported] == [
        ("abort-possible", "warning", 5, 1)
    ]
    assert reported[0].message == "the program may abort itself: input 0"
    reported.clear()
    run(ASKED.format(1), warn=reported.append)
    assert not reported


def test_a_real_answer_aborts() -> None:
    reading = interpret(Text.of_lines(ASKED.format(7).split("\n"), "test.nc"))
    asked = next(reading)
    assert isinstance(asked, WaitInput)
    asked.answer.values = (7.0,)
    assert isinstance(next(reading), Abort)
    with pytest.raises(GcodeError, match="input 7"):
        next(reading)

"""Values in the text of comments. The expected texts are LinuxCNC's, but for what its manual promises and it does not keep."""

from __future__ import annotations

import pytest

from cnc.gcode.codes.comments import fill
from cnc.gcode.syntax.parameters import Parameters
from tests.support.gcode.gcode_cases import run

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
    source = "#1=2.5\n#1=[#1*2] (debug, is %.1f#1) G0 X#1\n(print,#<_x> %d#5420)\n(msg, #1)\n(note #1)"
    assert [block.text for block in run(source) if hasattr(block, "text")] == ["is 5.0", "2.500000 2", "#1"]

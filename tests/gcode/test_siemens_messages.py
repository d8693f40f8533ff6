"""SINUMERIK's messages: texts and values, joined by <<."""

from __future__ import annotations

import pytest

from cnc.model.blocks import Message
from tests.support.gcode.gcode_cases import error_of, run


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("MSG()", ""),
        ('MSG("one")', "one"),
        ('N10 MSG ( "one" )', "one"),
        ('MSG("one"<<" two")', "one two"),
        ('MSG("X: "<<R1)', "X: 2.5"),
        ('MSG("X: " << R1 << " mm")', "X: 2.5 mm"),
        ('MSG("("<<NAME<<", "<<_OWN<<")",1)', "(-3, 0.125)"),
        ('MSG("%d #1 "<<R2)', "%d #1 0.3333333333"),
        ("MSG(NAME)", "-3"),
        ('MSG(7.50<<" of "<<10)', "7.5 of 10"),
        ('MSG("at "<<$AA_IW[X]<<" and "<<R1*2)', "at ###### and ######"),
    ],
)
def test_a_message_shows_texts_and_values(line: str, shown: str) -> None:
    program = f"DEF INT NAME=-3\nR1=2.5 R2=1/3\n_OWN=1/8\n{line}\nM30"
    blocks = run(program, dialect="siemens")
    assert [block.text for block in blocks if isinstance(block, Message)] == [shown]


@pytest.mark.parametrize("line", ['MSG("X: "<<)', 'MSG("X: " R1)', 'MSG("X: ', 'MSG("X"<<"Y)'])
def test_a_message_that_is_not_complete_is_refused(line: str) -> None:
    assert error_of(f"R1=1\n{line}\nM30", dialect="siemens").line == 2

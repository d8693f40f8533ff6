"""Findings as one types, and the state of lines."""

from __future__ import annotations

import math
import random
from pathlib import Path

import numpy as np
import pytest

from cnc import parse
from cnc.api import check, from_text
from cnc.editor.analysis import Settings, analysed
from cnc.editor.changes import all_repaired, in_style, repairs
from cnc.editor.document import Document
from cnc.editor.states import described, hint, line_states
from cnc.machine.load import load_machine
from cnc.model.blocks import ArcFeed, Polyline
from cnc.model.choices import DialectName
from cnc.model.diagnostics import CncError
from cnc.model.operator_control import Control
from cnc.session.options import RunOptions
from cnc.session.session import Session
from tests.support.corpus import STYLES
from tests.support.soak import share

MACHINE = load_machine(None)


def settings(dialect: DialectName = "linuxcnc") -> Settings:
    return Settings(MACHINE, RunOptions(dialect=dialect))


def found(text: str, dialect: DialectName = "linuxcnc") -> list[tuple[str, int, int]]:
    analysis = analysed(Document.of("a.nc", text), settings(dialect))
    return [(finding.code, finding.line, finding.column) for finding in analysis.findings]


@pytest.mark.parametrize("style", sorted(STYLES)[:: share(1, 6)])
def test_findings_are_those_of_a_check(style: str, tmp_path: Path) -> None:
    """Those of the plan (limits of the board's steps) come from a check alone."""
    text = STYLES[style](random.Random(style))
    file = tmp_path / "a.nc"
    file.write_text(text)
    wanted = Session(str(file), MACHINE, RunOptions()).run()
    analysis = analysed(Document.of(str(file), text), Settings(MACHINE, RunOptions()))
    of_the_plan = {"step-rate", "program-empty"}
    listed = [finding for finding in wanted.findings if finding.code not in of_the_plan]
    assert analysis.findings[: len(listed)] == listed


def test_errors_of_syntax_behind_the_first_error_are_found() -> None:
    text = "G0 X1\nX[1\nY2 (open\nG1 F100 Y3\nX--1\nM2\n%\nX[2\n"
    assert found(text) == [
        ("bracket-not-closed", 2, 2),
        ("comment-not-closed", 3, 4),
        ("number-malformed", 5, 1),
    ]
    assert found("") == []


def test_travel_is_checked() -> None:
    assert [code for code, *_ in found("G0 X5000\nM2\n")] == ["soft-limit"]


def test_travel_is_that_of_the_path_as_programmed() -> None:
    """A check compares the motion: the tolerance takes these ripples back inside the travel."""
    ripples = "".join(
        f"X{409.98 + 0.025 * (k % 2 if 9 < k < 50 else 0):.3f} Y{0.1 * k:.1f}\n"
        for k in range(1, 59)
    )
    text = f"G21 G90 G64 P0.05\nG1 X409.98 Y0 F600\n{ripples}G0 X0 Y0\nM2\n"
    assert {code for code, *_ in found(text)} == {"soft-limit"}
    assert check(from_text(text)).faults == []


def test_a_finding_of_a_subroutine_file_stands_at_the_top(tmp_path: Path) -> None:
    (tmp_path / "sub.ngc").write_text("o<sub> sub\nG0 X[1\no<sub> endsub\nM2\n")
    document = Document.of(str(tmp_path / "a.ngc"), "o<sub> call\nM2\n")
    (finding,) = analysed(document, settings()).findings
    assert (finding.line, finding.code) == (0, "bracket-not-closed")
    assert "sub.ngc:2:5" in finding.message


def test_a_stop_ends_the_reading() -> None:
    control = Control()
    control.stop()
    text = "G0 X1\n" * 3000 + "X[\n"
    assert analysed(Document.of("a.nc", text), settings(), control).findings == []


STATES = """\
G21 G90 G54
G10 L2 P1 X10 Y20
G0 X0 Y0 Z5
G91 G1 X3 Z-4 F120
G2 X2 I1
G4 P1.5
G90 G20 G1 X1
#1=0
o1 while [#1 lt 3]
G91 G1 X[0.1] F10
#1=[#1+1]
o1 endwhile
M2
"""


def test_states_have_positions_lengths_and_times() -> None:
    document = Document.of("a.nc", STATES)
    states = line_states(document, settings(), 1, document.count)
    assert sorted(states) == list(range(1, 14))
    assert states[3].end == (10.0, 20.0, 5.0)
    assert states[3].in_program() == (0.0, 0.0, 5.0)
    assert states[4].length == pytest.approx(5.0)
    assert states[4].seconds == pytest.approx(5.0 / 2.0)
    assert states[5].length == pytest.approx(math.pi)
    assert states[5].seconds == pytest.approx(math.pi / 2.0)
    assert states[6].seconds == pytest.approx(1.5)
    assert states[7].end[0] == pytest.approx(35.4)
    # The loop's line has the state of its first round.
    assert states[10].end[0] == pytest.approx(35.4 + 2.54)
    names = MACHINE.axis_names
    lines = described(states[7], names)
    assert lines[0] == "in effect: G1 G17 G20 G90 G94 F4.72441 M5"
    assert lines[1].startswith("position behind the line: X1 Y0 Z0.0394")
    assert hint(states[4], names, "G91 G1 X3 Z-4 F120") == "X3 Y0 Z1"
    assert hint(states[5], names, "G2 X2 I1") == "X5 Y0 Z1 F120"
    assert hint(states[6], names, "G4 P1.5") == ""


def test_a_rotated_position_is_that_of_the_machine() -> None:
    document = Document.of("a.nc", "G21 G90 G10 L2 P1 R90\nG0 X10 Y0\nM2\n")
    state = line_states(document, settings(), 2, 2)[2]
    assert state.in_program() is None
    assert hint(state, MACHINE.axis_names, "G0 X10 Y0") == "X0 Y10 Z0 (machine)"


@pytest.mark.parametrize("style", sorted(STYLES)[:: share(1, 8)])
def test_a_range_has_the_ends_of_the_blocks(style: str, tmp_path: Path) -> None:
    """Lines before the range are executed in bulk; the ends are those of all blocks."""
    text = STYLES[style](random.Random(style))
    file = tmp_path / "a.nc"
    file.write_text(text)
    ends: dict[int, list[float]] = {}
    try:
        for block in parse(str(file)):
            if isinstance(block, Polyline):
                ends |= dict(zip(block.lines.tolist(), block.points.tolist(), strict=True))
            elif isinstance(block, ArcFeed):
                ends[block.line] = block.end.tolist()
    except CncError:
        pass
    if "M98" in text or "CALL" in text.upper() or "WHILE" in text.upper() or "GOTO" in text:
        return  # a line that is executed again
    document = Document.of(str(file), text)
    middle = document.count // 2
    states = line_states(document, Settings(MACHINE, RunOptions()), middle, document.count)
    compared = [line for line in ends if line in states and states[line].modal.motion is not None]
    for line in compared:
        np.testing.assert_allclose(states[line].end, ends[line], atol=1e-9)


def test_changes_are_edits_of_the_text() -> None:
    document = Document.of("a.nc", "G21 (a (b))\r\nX1 y2\r\nM2\r\n")
    holds = settings("auto")
    analysis = analysed(document, holds)
    titles = [repair.title for repair in repairs(analysis, 2, 2)]
    assert "write G0" in titles
    assert list(repairs(analysis, 3, 3)) == []
    repaired = document.edited(all_repaired(document, holds), 2)
    assert repaired.text == "G21 (a [b])\r\nG0 X1 y2\r\nM2\r\n"
    assert repaired.edited(in_style(repaired, holds), 3).text == (
        "G21 (a [b])\r\nG0 X1 Y2\r\nM2\r\n"
    )
    with pytest.raises(CncError, match="bracket-not-closed"):
        in_style(Document.of("a.nc", "G0 X[1\nM2\n"), holds)

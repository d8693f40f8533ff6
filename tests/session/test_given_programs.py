"""Programs that are given as a text or as points, in place of a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import PlanChunk, check, from_points, from_text, load_machine, plan, run
from cnc.boards.loopback import Loopback
from cnc.model.diagnostics import UsageError

POINTS = np.array([[0.0, 0.0, 5.0], [30.0, 0.0, 5.0], [30.0, 40.0, 5.0]])


def test_points_are_reached_in_their_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    program = from_points(POINTS, feed=1200.0)
    report = check(program)
    assert report.ok
    # The traverse to the first point, 30 mm and 40 mm; the blend cuts the corner a little.
    assert report.path_length_mm == pytest.approx(5.0 + 30.0 + 40.0, abs=0.1)
    assert report.largest.feed <= 100.0
    chunks = [item for item in plan(program) if isinstance(item, PlanChunk)]
    assert chunks[0].t0 == 0.0
    board = Loopback(3)
    assert run(program, board=board).ok
    steps_per_mm = load_machine(None).steps_per_mm
    np.testing.assert_array_equal(board.position_steps, np.rint(POINTS[-1] * steps_per_mm))
    # A program without a file leaves none behind.
    assert list(tmp_path.iterdir()) == []


def test_a_fault_of_a_text_is_shown_with_its_line() -> None:
    (fault,) = check(from_text("G21 G90\nG1 X\n")).faults
    shown = fault.diagnostic
    assert (shown.file, shown.line, shown.code) == ("<text>", 2, "number-missing")
    assert shown.text == "G1 X"


@pytest.mark.parametrize(
    ("points", "feed"),
    [
        ([], 100.0),
        ([[1.0, 2.0]], 100.0),
        ([[1.0, 2.0, np.nan]], 100.0),
        ([1.0, 2.0, 3.0], 100.0),
        (POINTS, 0.0),
        (POINTS, np.inf),
    ],
)
def test_points_without_a_meaning_are_refused(points: object, feed: float) -> None:
    with pytest.raises(UsageError, match="points-shape"):
        from_points(points, feed)  # type: ignore[arg-type]


def test_a_loopback_board_says_what_it_takes() -> None:
    with pytest.raises(TypeError, match=r"the number of axes, not 'xyz': Loopback\(3\)"):
        Loopback("xyz")  # type: ignore[arg-type]

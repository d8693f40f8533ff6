"""Programs that are given as a text or as points, in place of a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import PlanChunk, check, from_points, from_text, load_machine, parse, plan, run
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


def test_the_plan_of_blocks_has_times_of_lines_and_positions() -> None:
    """Lines of 30 and 40 mm at 20 mm/s, far above the ramps; positions by numeric integration."""
    text = "G21 G90 G61\nF1200\nG1 X30\nG1 Y40\nM2\n"
    blocks = list(parse(from_text(text)))
    chunks = [item for item in plan(blocks) if isinstance(item, PlanChunk)]
    expected = [item for item in plan(from_text(text)) if isinstance(item, PlanChunk)]
    assert [item.duration for item in chunks] == [item.duration for item in expected]
    times: dict[int, float] = {}
    for item in chunks:
        for line, seconds in item.line_times():
            times[line] = times.get(line, 0.0) + seconds
    assert sum(times.values()) == pytest.approx(chunks[-1].t0 + chunks[-1].duration)
    assert 1.5 < times[3] < 1.8
    assert 2.0 < times[4] < 2.3
    for item in chunks:
        t = np.linspace(0.0, item.duration, 2001)
        places = item.positions(t)
        speed = np.linalg.norm(np.gradient(places, t, axis=0), axis=1)
        assert speed.max() == pytest.approx(20.0, rel=1e-3)
        length = float(item.phase_s[-1] - item.phase_s[0])
        assert np.linalg.norm(np.diff(places, axis=0), axis=1).sum() == pytest.approx(length)
    np.testing.assert_allclose(places[-1], [30.0, 40.0, 0.0], atol=1e-9)


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

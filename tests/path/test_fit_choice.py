"""Which parts of a chain are timed, and that the faster of spline and corners is kept."""

import math

import numpy as np
import pytest

from cnc.model.blocks import PathMode
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.fit import MOST_MOVES, Alternatives
from cnc.path.kernels.curve import LINE
from tests.support.planner.motions import AXES, lines

ZIGZAG = np.array([(1, 0, 0), (1, 1, 0), (2, 1, 0), (2, 2, 0), (3, 2, 0)], float)


def pieces(points, duration, tolerance=0.1):
    """The kinds of the pieces, if the faster path is chosen; without ``duration``, no answer."""
    path = build(
        [PathMode("t.nc", 1, "blend", tolerance), lines(points, 20.0)],
        axes=AXES,
        start=np.zeros(3),
        offers_corners=True,
    )
    chunks = []
    for item in path:
        if isinstance(item, PathChunk):
            chunks.append(item)
        elif isinstance(item, Alternatives) and duration is not None:
            item.answer.values = (float(duration(item.corners) < duration(item.spline)),)
    return np.concatenate([chunk.kind for chunk in chunks])


def prefers(lines_alone):
    """Return a duration that is shorter for paths of lines alone, or longer."""

    def duration(chunk):
        assert chunk.stop_after.tolist() == [False] * (len(chunk) - 1) + [True]
        return 1.0 if (chunk.kind == LINE).all() == lines_alone else 2.0

    return duration


@pytest.mark.parametrize("corners", [True, False])
def test_the_faster_of_spline_and_corners_is_kept(corners):
    kinds = pieces(ZIGZAG, prefers(corners))
    assert (kinds == LINE).all() == corners
    assert not corners or len(kinds) == len(ZIGZAG)


def test_the_spline_is_kept_without_an_answer_and_where_corners_save_nothing():
    assert (pieces(ZIGZAG, None) != LINE).any()
    assert (pieces(ZIGZAG, lambda chunk: 1.0) != LINE).any()
    assert (pieces(ZIGZAG, lambda chunk: math.inf) != LINE).any()


def polygon(headings, legs):
    heading = np.radians(headings)
    steps = np.stack([np.cos(heading), np.sin(heading), 0.0 * heading], axis=1)
    return np.cumsum(np.array(legs)[:, None] * steps, axis=0)


def staircase(moves):
    steps = np.zeros((moves, 3))
    steps[np.arange(moves), np.arange(moves) % 2] = 1.0
    return np.cumsum(steps, axis=0)


@pytest.mark.parametrize(("moves", "timed"), [(MOST_MOVES, True), (MOST_MOVES + 1, False)])
def test_parts_with_many_moves_are_curves(moves, timed):
    seen = []
    pieces(staircase(moves), lambda chunk: seen.append(chunk) or 1.0)
    assert bool(seen) == timed


@pytest.mark.parametrize(("turn", "timed"), [(35.0, False), (45.0, True)])
def test_parts_with_small_turns_alone_are_curves(turn, timed):
    seen = []
    pieces(polygon(turn * np.arange(6), [1.0] * 6), lambda chunk: seen.append(chunk) or 1.0)
    assert bool(seen) == timed


@pytest.mark.parametrize(("tolerance", "timed"), [(0.045, False), (0.055, True)])
def test_parts_with_long_moves_beside_sharp_turns_are_left_to_the_spline(tolerance, timed):
    seen = []
    pieces(ZIGZAG, lambda chunk: seen.append(chunk) or 1.0, tolerance)
    assert bool(seen) == timed


def test_a_part_is_timed_with_what_is_beside_it():
    """A stop at the corner between two parts would hide how fast it is passed."""
    sharp = (40.0, -20.0, 0.0)  # long legs beside a turn of more than 92 degrees: a corner
    points = np.concatenate((ZIGZAG, [sharp], sharp + [-1, 1, 0] * ZIGZAG))
    ends = []
    pieces(points, lambda chunk: ends.append(chunk.length.sum()) or 1.0)
    whole = np.linalg.norm(np.diff(points, axis=0, prepend=np.zeros((1, 3))), axis=1).sum()
    assert ends
    assert np.array(ends) == pytest.approx(whole, rel=0.02)


@pytest.mark.parametrize(("tolerance", "timed"), [(0.009, False), (0.011, True)])
def test_a_part_with_one_turn_is_timed_where_its_moves_are_no_longer(tolerance, timed):
    seen = []
    pieces(polygon([0.0, 45.0], [1.0, 1.0]), lambda chunk: seen.append(chunk) or 1.0, tolerance)
    assert bool(seen) == timed


def test_a_part_beside_a_sharp_corner_is_timed():
    """A corner between a curve and a move is a stop, so its small turn may be better a corner."""
    # A turn by 170 degrees is a corner in any case. Behind it is one of 26.
    points = polygon([0.0, 170.0, 196.0], [10.0, 0.5, 2.0])
    kinds = pieces(points, prefers(True), 0.1)
    assert kinds.tolist() == [LINE] * 3
    assert (pieces(points, prefers(False), 0.1) != LINE).any()


def test_parts_are_timed_again_when_one_beside_them_has_corners():
    points = polygon([0.0, 60.0, 230.0, 290.0, 350.0], [1.0] * 5)

    def duration(chunk):
        # The first of two parts is slower with a corner, unless the second one has one too.
        return {2: 1.0, 3: 1.2, 4: 0.9, 5: 0.5}[int((chunk.kind == LINE).sum())]

    assert pieces(points, duration, 0.1).tolist() == [LINE] * 5


def test_parts_with_nothing_changed_beside_them_are_timed_once():
    # Three parts between turns of 170 degrees, the last one behind a long curve.
    turns = [0.0, 60.0, 170.0, 60.0, 60.0, 170.0, *[4.0] * 16, 170.0, 60.0]
    heading = np.radians(np.cumsum(turns))
    points = np.cumsum(np.stack([np.cos(heading), np.sin(heading), 0.0 * heading], 1), axis=0)
    seen = []

    def duration(chunk):
        # The second part alone is faster with corners.
        seen.append((chunk.kind.tobytes(), chunk.data.tobytes()))
        return 0.5 if int((chunk.kind == LINE).sum()) == 5 else 1.0

    assert (pieces(points, duration, 0.1) == LINE).sum() > 4
    # Twice each, and the first part again.
    assert len(seen) == len(set(seen)) == 8

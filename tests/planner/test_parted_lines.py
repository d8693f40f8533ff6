"""A line on which the operator changes the feed is parted there.

Else the corner at its end would be passed at the higher of both feeds.
"""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from cnc.path.kernels.curve import START
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk, cut_at_time, joined_plans, part
from tests.support.planner.motions import lines, machine, path_of

END = np.array([30.0, 40.0, 5.0])


def slices_of(ends: list[float], feeds: list[float]) -> tuple[PlanChunk, list[PlanChunk]]:
    """Return the plan of one line, and its slices up to parts of its time, with these feeds."""
    (plan,) = LookAhead(machine()).plan(path_of([lines([END], 50.0)]))
    assert isinstance(plan, PlanChunk)
    slices, whole, first = [], plan, 0
    for end, feed in zip([*ends, 1.0], feeds, strict=True):
        last, whole = cut_at_time(whole, end * plan.duration)
        piece = part(whole, first, last)
        slices.append(replace(piece, path=replace(piece.path, feed=np.array([feed]))))
        first = last
    return plan, slices


@pytest.mark.parametrize(
    ("ends", "feeds", "parts"),
    [
        ([0.3], [50.0, 50.0], [50.0]),
        ([0.3], [50.0, 20.0], [50.0, 20.0]),
        ([0.3, 0.6], [50.0, 20.0, 20.0], [50.0, 20.0]),
        ([0.3, 0.6], [50.0, 50.0, 20.0], [50.0, 20.0]),
        ([0.3, 0.6, 0.8], [50.0, 20.0, 20.0, 40.0], [50.0, 20.0, 40.0]),
        ([0.3], [np.nan, np.nan], [np.nan]),
    ],
)
def test_slices_of_a_line_join_to_one_part_for_each_feed(ends, feeds, parts):
    plan, slices = slices_of(ends, feeds)
    joined = reduce(joined_plans, slices)
    path, n = joined.path, len(plan.path.axes)
    np.testing.assert_array_equal(path.feed, parts)
    assert joined.duration == pytest.approx(plan.duration, rel=1e-12)
    assert joined.phase_s[-1] == pytest.approx(np.linalg.norm(END), rel=1e-12)
    np.testing.assert_allclose(np.diff(joined.piece_s), path.length, rtol=1e-12)
    # Each part begins where the feed changes, and where the part before ends, to the last bit.
    begins = [path.data[at + START :][:n] for at in path.at]
    ends_at = [path.data[at + START + n :][:n] for at in path.at]
    for here, there in zip(ends_at[:-1], begins[1:], strict=True):
        np.testing.assert_array_equal(here, there)
    np.testing.assert_array_equal(ends_at[-1], END)
    along = END / np.linalg.norm(END)
    for begin, s in zip(begins, joined.piece_s[:-1].tolist(), strict=True):
        np.testing.assert_allclose(begin, s * along, atol=1e-12)


def test_only_the_last_part_of_a_line_has_the_corner_behind_it():
    _, slices = slices_of([0.4], [50.0, 20.0])
    slices = [
        replace(piece, path=replace(piece.path, tolerance=np.array([0.01]))) for piece in slices
    ]
    path = joined_plans(*slices).path
    np.testing.assert_array_equal(path.tolerance, [0.0, 0.01])
    np.testing.assert_array_equal(path.stop_after, [False, True])

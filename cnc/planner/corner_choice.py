r"""The faster of two motions along the same moves, by trials from rest to rest.

The path layer offers a spline or corners where moves are short (:class:`Alternatives`). Where the
spline is not the faster one, corners with blends or one motion past all of them are used.

Where the jerk is limited along the path alone, a blend is about as fast as any motion past its
corner if the legs have room for it. Where they are short, corners that are passed together may be
faster, by up to a fifth: the motion swings out before a turn. Which is faster depends on how the
limits of jerk and acceleration compare. So both are timed, from rest to rest.

           o                         o
     .-----'`----.             .--.     .--.
    /   blends    \          /     `-'     \      together
   o               o        o               o

Without the choice, 100 polygons with legs of 3 to 24 tolerances take 1.00 times as long in the
median, and 1.155 times at worst (limits along the path).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.path.fit import Alternatives
from cnc.path.kernels.curve import LINE, START, Pieces
from cnc.planner.acceptance import open_at_start
from cnc.planner.audit import Audit
from cnc.planner.corner_motions import CornerMotions
from cnc.planner.corners import CornerBlending
from cnc.planner.joints import Joints
from cnc.planner.kernels.corner_places import MOST_CORNERS
from cnc.planner.kernels.corner_search import new_solutions
from cnc.planner.kernels.corners import only_along
from cnc.planner.kernels.legs import record_end
from cnc.planner.kernels.lookahead import PLANNED
from cnc.planner.known_path import KnownPath
from cnc.planner.limits import Limits
from cnc.planner.phases import plan_to_rest
from cnc.planner.plan import joined_paths
from cnc.planner.work import FIRST_OF_TRIALS, INTERVAL, RATE_OF_TRIALS, Work

SHORT = 25.0
"""In tolerances. Corners with longer legs have blends."""

ENDS_SHORT = 100.0
"""In tolerances. So have corners beside longer legs: a longer ramp gains little, and most programs
have such legs.
"""

BESIDE = 100.0
"""In tolerances: length on each side that is timed with them. Beside a blend or a curve they may be
slower than alone.
"""

FASTER = 0.998
"""Corners are passed together where that takes less than this part of the time with blends."""

FASTER_THAN_SPLINE = 0.99
"""Corners are chosen where the motion takes less than this part of the time along the spline."""

TRIAL, CORNER = 2e-3, 0.05e-3
"""s; computing time of a trial with its path, without searches; and that of the blend at a corner.
"""


class Trials:
    """Times motions from rest to rest, as long as computing time is left.

    Where no axis limits the jerk they are not refined: that takes most of the time of a plan, saves
    about as much on both, and hardly changes the choice.

    Attributes:
        solutions: of the searches for motions past corners.
    """

    def __init__(self, limits: Limits, work: Work) -> None:
        """Create trials; ``limits``: of the columns of the paths."""
        self._limits, self._work = limits, work
        self.solutions = new_solutions(work.left)

    def passed_together(self, path: PathChunk, rests: bool) -> NDArray[np.bool_]:
        """Return for each piece of a path whether the corner behind it is passed with those beside.

        Args:
            path: pieces that follow each other.
            rests: whether the motion rests at their start.
        """
        chosen = np.zeros(len(path), np.bool_)
        if only_along(self._limits.arrays):
            self._work.left -= CORNER * np.count_nonzero(path.tolerance)
            s = np.concatenate(([0.0], np.cumsum(path.length)))
            for first, last in _rows(path):
                far = BESIDE * path.tolerance[first : last + 1].max()
                if (s[first + 1] < far and not rests) or (
                    s[-1] - s[last + 1] < far and not path.stop_after[-1]
                ):
                    # The path goes on: from or to a rest at its end the times would be wrong.
                    continue
                begin = max(int(np.searchsorted(s, s[first + 1] - far, side="right")) - 1, 0)
                end = min(int(np.searchsorted(s, s[last + 1] + far)), len(path)) - 1
                legs = _alone(path, begin, end)
                blends = chosen[begin : end + 1]
                together = blends.copy()
                together[first - begin : last + 1 - begin] = True
                times = self._times((legs, together), (legs, blends), passes=True)
                if times and times[0] < FASTER * times[1]:
                    chosen[first : last + 1] = True
        return chosen

    def answer(self, choice: Alternatives, joints: Joints) -> None:
        """Answer whether the motion of the tip has the corners."""
        paths = [_with_joints(path, joints) for path in (choice.spline, choice.corners)]
        stops = (np.zeros(len(path), np.bool_) for path in paths)
        passes = not only_along(self._limits.arrays)
        if times := self._times(*zip(paths, stops, strict=True), passes=passes):
            self._work.earn(choice.share * min(times))
            choice.answer.values = (float(times[1] < FASTER_THAN_SPLINE * times[0]),)

    def _times(self, *paths: tuple[PathChunk, NDArray[np.bool_]], passes: bool) -> list[float]:
        """Return the time along each path, s; infinite without a motion. Nothing without work.

        Args:
            paths: each with the corners of it that are passed together.
            passes: whether the motion passes stops. Where corners have blends few are left.
        """
        if self._work.left[0] <= 0.0:
            return []
        corners = sum(np.count_nonzero(path.tolerance) for path, _ in paths)
        self._work.left -= TRIAL * len(paths) + CORNER * corners
        return [self._time(legs, together, passes) for legs, together in paths]

    def _time(self, legs: PathChunk, together: NDArray[np.bool_], passes: bool) -> float:
        """Return the time of the motion along a path, s; infinite without one."""
        limits = self._limits
        (path,) = CornerBlending(limits, together=lambda *_: together).blended(iter((legs,)))
        assert isinstance(path, PathChunk)
        known = KnownPath(limits)
        section = known.add(path, None, None)
        goal, _ = known.goal(0.0)
        intervals = open_at_start(known.intervals(limits, 0.0, goal))
        self._work.left -= INTERVAL * len(intervals.end)
        refinement = None if only_along(limits.arrays) else self._work
        status, phases = plan_to_rest(0.0, intervals, 0.0, limits, work=refinement)
        if status != PLANNED:
            return math.inf
        if not (passes and path.tolerance.any()):
            return float(phases["duration"].sum())
        plan = section.plan_chunk(phases, (goal, 0.0, 0.0), limits, 0.0)
        self.solutions.promised[0] = 1.0
        corners = CornerMotions(limits, Audit(limits), self._work, self.solutions)
        try:
            parts = [*corners.passed((plan,)), *corners.flush()]
        except MotionLimitError:
            return math.inf
        return sum(part.plan.duration for part in parts)


def with_faster_paths(
    path: Iterable[PathChunk | Block], machine: Machine
) -> Iterator[PathChunk | Block]:
    """Choose the faster of each :class:`Alternatives` in a path of the tip, and yield the rest.

    The trials have computing time of their own. So the path does not depend on the requests of an
    operator, and is that of the check pass.
    """
    joints = Joints(machine)
    trials = Trials(Limits.of(machine), Work(FIRST_OF_TRIALS, RATE_OF_TRIALS))
    for item in path:
        if isinstance(item, Alternatives):
            trials.answer(item, joints)
        else:
            yield item


def _with_joints(path: PathChunk, joints: Joints) -> PathChunk:
    """Return a path of the tip with the columns of the joints, which are linear."""
    start = path.data[path.at[0] + START :][: len(path.axes)]
    chunks = (item for item in joints.path(iter((path,)), start) if isinstance(item, PathChunk))
    return reduce(joined_paths, chunks)


def _rows(path: PathChunk) -> Iterator[tuple[int, int]]:
    """Yield the first and the last corner of each row of corners between short legs.

    Rows of more corners than one motion passes are left out, and those that end with longer legs.
    """
    line = path.kind == LINE
    corner = (path.tolerance[:-1] > 0.0) & ~path.stop_after[:-1] & line[:-1] & line[1:]
    short = path.length < SHORT * np.maximum(
        path.tolerance, np.concatenate(([0.0], path.tolerance[:-1]))
    )
    joined = corner[1:] & corner[:-1] & short[1:-1]
    corners = np.flatnonzero(corner & (short[1:] | short[:-1]))
    begin = 0
    for k in range(len(corners)):
        if k + 1 == len(corners) or corners[k + 1] > corners[k] + 1 or not joined[corners[k]]:
            first, last = int(corners[begin]), int(corners[k])
            ends = (path.length[first], path.length[last + 1])
            if last - first < MOST_CORNERS and max(ends) < ENDS_SHORT * path.tolerance[first]:
                yield first, last
            begin = k + 1


def _alone(path: PathChunk, first: int, last: int) -> PathChunk:
    """Return the pieces ``first`` to ``last`` as a path that ends at rest, without commands."""
    legs = path.part(first, last + 1)
    stops, tolerance = legs.stop_after.copy(), legs.tolerance.copy()
    stops[-1], tolerance[-1] = True, 0.0
    begin = int(legs.at[0])
    end = record_end(Pieces(legs.kind, legs.at, legs.data), len(legs) - 1)
    return replace(
        legs,
        at=legs.at - begin,
        data=legs.data[begin:end],
        stop_after=stops,
        tolerance=tolerance,
        commands=None,
    )

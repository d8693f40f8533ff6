"""The joints of a machine: their positions, and their columns in a path of the tool tip."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.five_axis import FiveAxis
from cnc.kinematics.interval import Interval
from cnc.kinematics.orientation import Swing, angles_of, swing
from cnc.kinematics.series import Series, Term
from cnc.machine.models import Machine
from cnc.model.blocks import ROTARY_LETTERS, Answer, Block, Probe, TipControl
from cnc.model.diagnostics import Diagnostic, MachineFileError, MotionLimitError
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LINE, METRICS, SPAN, START, U0, U1
from cnc.planner.corners import CornerBlending
from cnc.planner.joint_map import JointMap
from cnc.planner.kernels.joint_records import (
    LARGEST_TABLE,
    ORDER,
    JointPieces,
    joint_record_size,
    write_joint_records,
)
from cnc.planner.limits import Limits
from cnc.planner.roots import roots
from cnc.planner.take_up import Play, Sides, TakeUp, part_lengths, plays_of
from cnc.planner.tip_series import Parts, joined, tip_series

Ints = NDArray[np.int64]


Floats = NDArray[np.float64]

SAME = 1e-3
"""Joints that differ by less are the same pose, mm or degrees."""
SHORT_LEGS = 4
"""So many vertices in a row are no curve, however short their legs are."""


class Joints:
    """The joints of a machine.

    Args:
        machine: The machine.

    Attributes:
        machine: A machine whose axes are the joints, for pulses and boards.
        tip_columns: Number of columns of the tool tip in front of those of the joints in a path; 0
            where the axes are the joints.
        tip_axes: Letters of the axes, which are the columns of a tip.
        linear: Whether the joints are a linear function of the tip.
        home_alone: Whether each joint has a switch and homes alone.
        short_legs: Most vertices in a row with short legs in a polygon whose legs stay straight;
            None where the ramps beside a stop are not straight. Where the jerk of an axis is
            limited, one motion passes several corners, so it is SHORT_LEGS; else blends need longer
            legs.
        angular: Whether each joint turns: its unit is the degree.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine.of_joints
        self.tip_axes = machine.axis_names
        self._map: JointMap | None = None
        self._plays: dict[int, Play] = {}
        if machine.tip_columns:
            self._map = JointMap.of(machine)
            self._plays = plays_of(machine)
            self._limits = Limits.of_tip(machine)
        self.tip_columns = machine.tip_columns
        self.linear = self._map is None or self._map.linear
        self.home_alone = not self.linear or machine.is_compensated
        self.short_legs: int | None = None
        if self.linear:
            by_axis = any(axis.max_jerk is not None for axis in machine.axes.values())
            self.short_legs = SHORT_LEGS if by_axis or machine.path.max_jerk is None else 0
        self.angular = tuple(letter in ROTARY_LETTERS for letter in self.tip_axes)
        if self._map is not None:
            self.angular = self._map.angular

    def at(self, tip: Floats) -> Floats:
        """Return the joints (joints,) at a position of the tip (axes,); mm, degrees.

        Raises:
            MachineFileError: ``start-out-of-reach`` where the joints do not reach it.
        """
        if self._map is None:
            return tip
        if not self.reach(tip):
            message = f"the joints do not reach the start position {_words(self.tip_axes, tip)}"
            hint = "write into [machine] start where the machine stands, or correct [kinematics]"
            raise MachineFileError(Diagnostic("start-out-of-reach", message, hint=hint))
        joints: Floats = self._map.inverse(tip[None])[0]
        return joints

    def tip_of_start(self, joints: Floats) -> Floats:
        """Return the tip (axes,) at the joints (joints,) of the machine file; mm, degrees.

        Raises:
            MachineFileError: ``start-out-of-reach`` where the machine never has these joints.
        """
        tip = self.tip(joints)
        if not np.allclose(self.at(tip), joints, rtol=0.0, atol=1e-6):
            values = zip(self.machine.axes, joints.tolist(), strict=True)
            place = " ".join(f"{name} = {value:g}" for name, value in values)
            message = f"the joints of the start are no pose of this kinematics: {place}"
            hint = "angles lie within half a turn of 0; an elbow bends to one side only"
            raise MachineFileError(Diagnostic("start-out-of-reach", message, hint=hint))
        return tip

    def determined(self, joints: Floats) -> bool:
        """Return whether the tip determines the joints (joints,): not at the pole of a table."""
        if self._map is None:
            return True
        apart = self.at(self.tip(joints)) - joints
        apart[self._map.turning] = (apart[self._map.turning] + 180.0) % 360.0 - 180.0
        return bool(np.abs(apart).max() < SAME)

    def reach(self, tip: Floats) -> bool:
        """Return whether the joints reach a position of the tip (axes,)."""
        return self._map is None or bool(np.isfinite(self._map.inverse(tip[None])).all())

    def tip(self, joints: Floats) -> Floats:
        """Return the tip (axes,) at a position of the joints (joints,); mm, degrees."""
        tip: Floats = self.tips(joints[None])[0]
        return tip

    def tips(self, joints: Floats) -> Floats:
        """Return the tips (n, axes) at positions of the joints (n, joints); mm, degrees."""
        return joints if self._map is None else self._map.forward(joints)

    @property
    def has_play(self) -> bool:
        """Whether an axis has backlash. At rest between programs, motors push all nuts up."""
        return bool(self._plays)

    @property
    def plays(self) -> dict[str, float]:
        """The largest backlash of each axis that has one, mm."""
        return {self.tip_axes[k]: play.largest for k, play in self._plays.items()}

    def sides_at(self, columns: Floats) -> dict[int, float]:
        """Return the sides of the nuts, by column, at a place of a path (columns,)."""
        tip, joints = columns[: self.tip_columns], columns[self.tip_columns :]
        up, down = (
            self._with_sides(dict.fromkeys(self._plays, side)).inverse(tip[None])[0]
            for side in (1.0, -1.0)
        )
        return {
            k: float(np.clip((2.0 * joints[k] - up[k] - down[k]) / (up[k] - down[k]), -1.0, 1.0))
            for k in self._plays
        }

    def tip_on(self, joints: Floats, sides: Mapping[int, float]) -> Floats:
        """Return the tip (axes,) at joints (joints,) whose nuts have sides; mm, degrees."""
        tip: Floats = self._with_sides(sides).forward(joints[None])[0]
        return tip

    def _with_sides(self, sides: Mapping[int, float]) -> JointMap:
        assert self._map is not None
        return self._map.with_sides({k: np.array([side]) for k, side in sides.items()})

    def tips_from(self, start: Floats) -> Callable[[Floats], Floats]:
        """Return a function that gives the tips (n, axes) at joints (n, joints), in order.

        It follows the nuts from place to place. A nut that turned twice between two places is off
        by its backlash at most, until it has moved so far.

        Args:
            start: The joints before the first place (joints,), whose nuts are pushed up.
        """
        if self._map is None or not self._plays:
            return self.tips
        joint_map, nuts, before = self._map, dict.fromkeys(self._plays, 1.0), start

        def tips(joints: Floats) -> Floats:
            nonlocal before
            sides: dict[int, Series | Floats] = {}
            for k, play in self._plays.items():
                side, followed = nuts[k], []
                moves = np.diff(joints[:, k], prepend=before[k]) * (2.0 / play.largest)
                for move in moves.tolist():
                    side = min(max(side + move, -1.0), 1.0)
                    followed.append(side)
                nuts[k], sides[k] = side, np.array(followed)
            before = joints[-1]
            return joint_map.with_sides(sides).forward(joints)

        return tips

    def with_tool(self, offset: tuple[float, float, float] | None) -> Joints:
        """Return the joints under tool-tip control, or without it for None.

        Args:
            offset: Offset of the tool along X, Y and Z, mm.
        """
        other = copy(self)
        other._map = None if self._map is None else self._map.with_tool(offset)
        return other

    def columns(self, tip: Floats) -> Floats:
        """Return a position in the columns of a path: the tip, then the joints if they differ."""
        return tip if self._map is None else np.concatenate((tip, self.at(tip)))

    def path(
        self, stream: Iterator[PathChunk | Block], start: Floats, *, certain: bool = True
    ) -> Iterator[PathChunk | Block]:
        """Yield a path of the tip with the columns of the joints, if they are not the axes.

        Args:
            stream: The path.
            start: The tip before the path (axes,), mm.
            certain: Where the tip leaves a joint free, as at the pole of a table, it stands at 0.

        Raises:
            MotionLimitError: ``out-of-reach`` or ``singular-pose``.
        """
        if self._map is None:
            return stream

        joints = self.at(start)
        path = JointPath(self._map, start, joints, self._limits, self._plays, leaves=certain)
        return path.passed(stream)


class ToolTipOf:
    """Positions of joints and tip of a machine with tool-tip control, for the language."""

    def __init__(self, bare: JointMap, table: FiveAxis, letters: tuple[str, ...]) -> None:
        self._bare = bare
        self.rotary = letters.index(table.tilting), letters.index("c")
        signs = [-1.0 if name in table.reverse else 1.0 for name in (table.tilting, "c")]
        self._signs = signs[0], signs[1]
        self._shift = 90.0 if table.tilting == "a" else 0.0
        self.points_missing = tuple(
            name for name in ("tilt_point", "turn_point") if name not in table.model_fields_set
        )

    @classmethod
    def machine(cls, machine: Machine) -> ToolTipOf | None:
        """Return the positions of a machine; None for one without tool-tip control."""
        if not machine.kinematics.with_tip_control:
            return None

        bare = JointMap.of(machine)
        assert bare is not None
        assert isinstance(machine.kinematics, FiveAxis)
        return cls(bare, machine.kinematics, machine.axis_names)

    def joints(self, tip: list[float], offset: tuple[float, float, float]) -> list[float]:
        """Return the joints (axes,) of a tip (axes,) with a tool offset (X, Y, Z)."""
        joints: list[float] = self._bare.with_tool(offset).inverse(np.array([tip]))[0].tolist()
        return joints

    def tip(self, joints: list[float], offset: tuple[float, float, float]) -> list[float]:
        """Return the tip (axes,) of joints (axes,) with a tool offset (X, Y, Z)."""
        position: list[float] = self._bare.with_tool(offset).forward(np.array([joints]))[0].tolist()
        return position

    def angles(self, here: list[float], direction: Floats) -> tuple[float, float]:
        """Return tilt and turn of a direction of the tool (3,), from a position (axes,)."""
        tilt, turn = angles_of(self._effective(here), direction, self._shift)
        return tilt * self._signs[0], turn * self._signs[1]

    def swing(self, here: list[float], direction: Floats) -> Swing | None:
        """Return the great circle from a position (axes,) to a direction of the tool (3,)."""
        turn = swing(self._effective(here), direction, self._shift)
        if turn is None:
            return None
        signs = self._signs
        end = turn.end[0] * signs[0], turn.end[1] * signs[1]
        angles = turn.angles if not len(turn.angles) else turn.angles * np.array(signs)
        return turn._replace(end=end, angles=angles)

    def _effective(self, here: list[float]) -> tuple[float, float]:
        """Return tilt and turn of a position (axes,) in the directions of ISO 841."""
        tilt, turn = self.rotary
        return here[tilt] * self._signs[0], here[turn] * self._signs[1]


# The path of the joints beside that of the tool tip.
#
#     chunk: x y z  ->  parts  ->  series of tip and joints  ->  chunk: x y z | a b c
#
# The columns of the joints ride along with those of the tip: length, feed and tolerance are
# measured at the tip, and the limits of velocity, acceleration and jerk are those of the joints.
# Each piece is cut into parts on which every column is a polynomial of degree 7 in the parameter u.
# It takes over the position and three derivatives at both ends of the part, so the joints have no
# jump of acceleration or jerk where parts meet. The remainder of this Hermite interpolation (Davis,
# Interpolation and Approximation, 1963, theorem 3.5.1) on a part of length h is
#
#     |q(u) - p(u)| <= max |q^(8)| / 8! * max |(u - u0)^4 (u - u1)^4| = M h^8 / 256
#
# M bounds the eighth term of the Taylor series over the part: it is computed with intervals in
# place of numbers. So ACCURACY is not measured at samples but proved. A straight line under a
# linear kinematics stays a line.


ACCURACY = 1e-6
"""Largest distance of a column from the exact motion, mm or degrees."""
LENGTH_ACCURACY = 1e-12
"""Largest error of the inverse arc length, mm."""
SHORTEST = 2.0**-20
"""Share of a piece below which a part is not cut again: the kinematics is singular there."""
MOST_PARTS = 8
"""Parts into which a part is cut at once."""
SEARCHED = 257
"""Places of a piece at which the reach is examined for an error message."""
TURN = 360.0
SAME_ANGLE = 1e-6
"""Angles that differ by less are the same, degrees."""


AllSides = Mapping[int, Sides]
"""Sides of the nuts, by the column of their axis."""
NO_SIDES: AllSides = {}
BEGIN, END = Sides._fields.index("begin"), Sides._fields.index("end")


class JointPath:
    """Adds the columns of the joints to a path.

    Args:
        joints: the joints of the machine.
        tip: (axes,): the tip before the path, mm or degrees.
        start: (joints,): the joints before the path, mm or degrees.
        limits: of the tip, for the choice of blends at its corners.
        plays: plays of nuts by the column of their axis.
        leaves: whether the joints are certain where the path begins in a singular pose.
    """

    def __init__(
        self,
        joints: JointMap,
        tip: Floats,
        start: Floats,
        limits: Limits,
        plays: Mapping[int, Play],
        *,
        leaves: bool,
    ) -> None:
        self._joints = joints
        self._tip: Floats | None = tip
        self._now = start
        self._leaves = leaves
        self._take_up = TakeUp(plays) if plays else None
        # A blend of the tip becomes a smooth path of joints. Where these are linear, blends are
        # made of their straight moves, which ramps may replace.
        self._blending = CornerBlending(limits, ramps=False, where=lambda: not self._joints.linear)

    def passed(self, stream: Iterable[PathChunk | Block]) -> Iterator[PathChunk | Block]:
        """Yield the stream; its chunks have the columns of the tip, then those of the joints.

        Raises:
            MotionLimitError: ``out-of-reach``, or ``singular-pose`` where a joint has no place, or
                no bounded speed, on the path.
        """
        answer: Answer | None = None
        for item in self._blending.blended(stream):
            if isinstance(item, PathChunk):
                yield self._with_joints(item)
            else:
                if isinstance(item, TipControl):
                    self._joints = self._joints.with_tool(item.offset)
                yield item
                answer = item.answer if isinstance(item, Probe) else None
            # The path behind the move of a probe is read after this.
            if answer is not None and answer.of_joints:
                self._take_contact(answer)

    def _take_contact(self, answer: Answer) -> None:
        """Give the answer of a probe the tip, from the joints that the board has counted."""
        assert answer.values is not None
        contact, *joints = answer.values
        there = self._joints
        if self._take_up is not None:
            there = there.with_sides({k: np.array([s]) for k, s in self._take_up.sides.items()})
        tip = there.forward(np.array([joints]))[0]
        answer.values, answer.of_joints = (contact, *tip.tolist()), False

    def _with_joints(self, path: PathChunk) -> PathChunk:
        leaving, joints = self._leaving(path)
        parts, sides = self._parts(path, leaving), NO_SIDES
        if self._take_up is not None:
            parts, sides = self._with_take_up(path, parts, self._take_up)
        pieces = self._pieces(path, parts, leaving, joints, sides)
        self._tip = None
        data, at, length = joint_records(pieces)
        piece = parts.piece
        ends = np.append(piece[1:] != piece[:-1], True)
        begins = np.insert(ends[:-1], 0, True)
        commands = None
        if path.commands is not None:
            commands = np.full(len(piece), None, object)
            commands[begins] = path.commands
        return replace(
            path,
            axes=(*path.axes, *self._joints.columns),
            kind=pieces.kind,
            at=at,
            data=data,
            length=length,
            feed=path.feed[piece],
            line=path.line[piece],
            stop_after=path.stop_after[piece] & ends,
            tolerance=np.where(ends, path.tolerance[piece], 0.0),
            commands=commands,
        )

    def _leaving(self, path: PathChunk) -> tuple[NDArray[np.bool_], Floats]:
        """Return the pieces that leave a singular pose in the direction in which it is regular.

        Only the first piece can, and only where its joints stand already.

        Returns:
            Whether each piece is such a piece (m,), and the joints at its start (m, joints).
        """
        columns = np.arange(START, START + len(path.axes))
        start = path.data[path.at[:, None] + columns]
        end = path.data[path.at[:, None] + columns + len(path.axes)]
        leaves, joints = self._joints.leaving(start, end)
        turned = (joints - self._now)[:, self._joints.turning]
        turned = np.abs((turned + 0.5 * TURN) % TURN - 0.5 * TURN).max(axis=1, initial=0.0)
        leaves &= (path.kind == LINE) & (turned < SAME_ANGLE)
        leaves[1:] = False
        leaves &= self._leaves and self._tip is not None
        return leaves, joints

    def _parts(self, path: PathChunk, leaving: NDArray[np.bool_]) -> Parts:
        """Return the parts of all pieces, in order, on which the polynomials are exact enough.

        Pieces that leave a singular pose are not cut.
        """
        u0, u1 = path.data[path.at + U0], path.data[path.at + U1]
        shortest = SHORTEST * (u1 - u0)
        open_parts = Parts(np.arange(len(path)), u0.copy(), u1.copy())
        done: list[Parts] = []
        whole = (path.kind == LINE) & self._joints.straight | leaving
        done.append(open_parts.of(whole))
        open_parts = open_parts.of(~whole)
        while len(open_parts.piece):
            error = self._remainder(path, open_parts)
            fits = error <= ACCURACY
            done.append(open_parts.of(fits))
            rest, error = open_parts.of(~fits), error[~fits]
            # Cutting a part that is out of reach everywhere would never end.
            reached = np.isfinite(self._joints.inverse(self._tips(path, rest.ends)))
            outside: NDArray[np.bool_] = ~np.all(reached, axis=1)
            if outside.any():
                self._refuse(path, rest.of(outside))
            narrow = rest.last - rest.first < shortest[rest.piece]
            if narrow.any():
                self._refuse(path, rest.of(narrow))
            border = self._borders(path, rest)
            crosses = ~np.isnan(border)
            halves, rest, error = rest.of(crosses), rest.of(~crosses), error[~crosses]
            open_parts = joined(
                _cut(rest, _wanted(error)),
                halves._replace(last=border[crosses]),
                halves._replace(first=border[crosses]),
            )
        return joined(*done).in_order

    def _with_take_up(
        self, path: PathChunk, parts: Parts, take_up: TakeUp
    ) -> tuple[Parts, AllSides]:
        """Return the parts with the sides of the nuts, cut until the polynomials are exact."""
        u0, u1 = path.data[path.at + U0], path.data[path.at + U1]
        shortest = SHORTEST * SHORTEST * (u1 - u0)
        parts, courses = take_up.courses(path, parts)
        while True:
            windows = [course.window for course in courses.values()]
            inside = np.flatnonzero((np.array(windows) >= 0).any(axis=0))
            lengths = np.zeros(len(parts.piece))
            lengths[inside] = part_lengths(path, parts.of(inside))
            sides = {axis: course.sides(lengths) for axis, course in courses.items()}
            if not len(inside):
                return parts, sides
            some = parts.of(inside)
            error = self._remainder(path, some, {k: s.of(inside) for k, s in sides.items()})
            far = error > ACCURACY
            if not far.any():
                return parts, sides
            narrow = far & (some.last - some.first < shortest[some.piece])
            if narrow.any():
                self._refuse(path, some.of(narrow))
            counts = np.ones(len(parts.piece), np.int64)
            counts[inside[far]] = _wanted(error[far])
            parts = _cut(parts, counts)
            courses = {axis: course.repeated(counts) for axis, course in courses.items()}

    def _borders(self, path: PathChunk, parts: Parts) -> Floats:
        """Return the parameters (m,) at which parts cross a border of their formulas, or NaN."""
        weights, places = self._joints.border(
            self._tips(path, parts.starts), self._tips(path, parts.ends)
        )
        borders = np.full(len(places), np.nan)
        crossing = np.flatnonzero(~np.isnan(places))
        some, row, place = parts.of(crossing), weights[crossing], places[crossing]

        def beyond(u: Floats) -> Floats:
            tips = self._tips(path, Parts(some.piece, u, u))
            distance: Floats = (row * tips).sum(axis=1) - place
            return distance

        borders[crossing] = roots(beyond, some.first, some.last)
        return borders

    def _remainder(self, path: PathChunk, parts: Parts, sides: AllSides = NO_SIDES) -> Floats:
        """Return a bound on the distance of the polynomials from the motion (m,), mm or degrees."""
        tip = tip_series(path, parts, ORDER, bounds=True)
        shares = {axis: Interval(side.begin, side.end) for axis, side in sides.items()}
        joints = _sided(self._bound_to(path, parts), tip, sides, shares).series(tip)
        worst = np.zeros(len(parts.piece))
        for series in (*tip, *joints):
            worst = np.maximum(worst, _size(series.terms[ORDER]))
        bound: Floats = worst * (0.5 * (parts.last - parts.first)) ** 8
        # An angle may turn by less than half a turn, or its turns could not be counted.
        for column in np.flatnonzero(self._joints.turning).tolist():
            swept = _size(joints[column].terms[1]) * (parts.last - parts.first)
            bound = np.where(swept < 0.5 * TURN, bound, np.inf)
        return np.where(np.isnan(bound), np.inf, bound)

    def _refuse(self, path: PathChunk, parts: Parts) -> None:
        """Raise the error of the first of some parts on which the joints have no bounded motion."""
        place = int(parts.piece[0])
        # The edge of the reach is singular, too: a path that goes beyond it is out of reach.
        u0, u1 = path.data[path.at[place] + U0], path.data[path.at[place] + U1]
        u = np.linspace(u0, u1, SEARCHED)
        beyond = self._tips(path, Parts(np.full(SEARCHED, place), u, u))
        outside = ~np.isfinite(self._joints.inverse(beyond)).all(axis=1)
        there = self._tips(path, parts.of(np.array([0])).starts)[0]
        if outside.any():
            there = beyond[int(np.argmax(outside))]
        begins = self._tip is not None and np.abs(there - self._tip).max() < ACCURACY
        if self._tip is not None and begins:
            there = self._tip
        named = _words(path.axes, there)
        if not outside.any():
            code, message = "singular-pose", f"the joints turn without bound near {named}"
            hint = "keep the path clear of the pose in which the kinematics is singular"
            if begins:
                message = f"the program begins at {named}, where the kinematics is singular"
                hint = (
                    "write where the machine stands into [machine] start = { x = .., y = .. }, "
                    "or home it before the program"
                )
        else:
            code, message = "out-of-reach", f"the joints do not reach {named}"
            hint = "move the part or the work offset, or correct [kinematics] in the machine file"
        raise MotionLimitError(
            Diagnostic(code, message, path.file, int(path.line[place]), hint=hint)
        )

    def _tips(self, path: PathChunk, places: Parts) -> Floats:
        """Return the tip at places of a path (m, axes)."""
        series = tip_series(path, places, 0, bounds=False)
        return np.stack([np.asarray(axis.terms[0]) for axis in series], axis=-1)

    def _pieces(
        self,
        path: PathChunk,
        parts: Parts,
        leaving: NDArray[np.bool_],
        joints: Floats,
        sides: AllSides,
    ) -> JointPieces:
        """Return the pieces of all parts.

        Args:
            path: the path.
            parts: its parts.
            leaving: whether each piece leaves a singular pose (pieces,).
            joints: the joints at the start of these pieces (pieces, joints).
            sides: the sides of the nuts on the parts, by the column of their axis.
        """
        at = path.at[parts.piece]
        straight = leaving[parts.piece]
        if self._joints.straight:
            straight = path.kind[parts.piece] == LINE
            for side in sides.values():
                straight &= ~side.changes
        bound = self._bound_to(path, parts)
        tips = [tip_series(path, ends, 3, bounds=False) for ends in (parts.starts, parts.ends)]
        shares = [{axis: side[k] for axis, side in sides.items()} for k in (BEGIN, END)]
        left = _columns(_sided(bound, tips[0], sides, shares[0]), tips[0])
        right = _columns(_sided(bound, tips[1], sides, shares[1]), tips[1])
        self._take_exact_ends(path, parts, left, right, sides)
        alone = np.flatnonzero(leaving[parts.piece])
        left[0][alone, len(path.axes) :] = joints[parts.piece[alone]]
        self._count_turns(left, right)
        # Neighbours meet to the last bit.
        start, end = left[0], right[0]
        end[:-1] = start[1:]
        form = _hermite(left, right, parts.last - parts.first)
        form[:, ORDER - 1] = end - start
        kind = np.where(straight, LINE, SPAN)
        return JointPieces(
            kind,
            parts.first,
            parts.last,
            path.data[at[:, None] + np.arange(METRICS, METRICS + 4)],
            start,
            end,
            form,
        )

    def _bound_to(self, path: PathChunk, parts: Parts) -> JointMap:
        """Return the joints on these parts of the path."""
        three = (parts.starts, parts.middles, parts.ends)
        return self._joints.bound_to(*(self._tips(path, places) for places in three))

    def _take_exact_ends(
        self, path: PathChunk, parts: Parts, left: Floats, right: Floats, sides: AllSides
    ) -> None:
        """Replace the positions at the ends of pieces by those of the records."""
        axes = len(path.axes)
        at = path.at[parts.piece]
        for places, u, ends, first, share in (
            (left, parts.first, path.data[at + U0], START, BEGIN),
            (right, parts.last, path.data[at + U1], START + axes, END),
        ):
            exact = np.flatnonzero(u == ends)
            tip = path.data[at[exact][:, None] + np.arange(first, first + axes)]
            places[0][exact, :axes] = tip
            there = {axis: side.at(side[share])[exact] for axis, side in sides.items()}
            places[0][exact, axes:] = self._joints.with_sides(there).inverse(tip)

    def _count_turns(self, left: Floats, right: Floats) -> None:
        """Add whole turns to the angles, so that each part goes on where the last one ended."""
        axes = left.shape[2] - len(self._joints.columns)
        for column in np.flatnonzero(self._joints.turning).tolist():
            a, b = left[0][:, axes + column], right[0][:, axes + column]
            before = np.concatenate(([self._now[column]], b[:-1]))
            inside = np.rint((a - b) / TURN)
            between = np.rint((before - a) / TURN)
            turns = np.cumsum(between + np.concatenate(([0.0], inside[:-1])))
            a += TURN * turns
            b += TURN * (turns + inside)
        self._now = right[0][-1, axes:].copy()


def _wanted(error: Floats) -> Ints:
    """Return into how many parts to cut parts with these errors (m,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        wanted = np.ceil(1.1 * (error / ACCURACY) ** 0.125)
    return np.where(np.isfinite(wanted), np.clip(wanted, 2, MOST_PARTS), 2).astype(np.int64)


def _sided(
    joints: JointMap, tip: list[Series], sides: AllSides, shares: Mapping[int, Floats | Interval]
) -> JointMap:
    """Return the joints with the sides of the nuts at shares of their windows."""
    series: dict[int, Series | Floats] = {
        axis: side.series(tip, shares[axis]) if side.changes.any() else side.before
        for axis, side in sides.items()
    }
    return joints.with_sides(series) if series else joints


def _columns(joints: JointMap, tip: list[Series]) -> Floats:
    """Return the terms of tip and joints (4, m, columns)."""
    every = (*tip, *joints.series(tip))
    return np.stack([np.stack([np.asarray(t) for t in s.terms]) for s in every], axis=-1)


def _words(axes: Sequence[str], position: Floats) -> str:
    """Return a position (axes,) as words of a program, for messages."""
    values = zip(axes, position.tolist(), strict=True)
    return " ".join(f"{axis.upper()}{value:.6g}" for axis, value in values)


def _size(term: Term) -> Floats | float:
    """Return the largest absolute value in intervals (m,)."""
    return np.maximum(-term.lo, term.hi) if isinstance(term, Interval) else abs(term)


def _cut(parts: Parts, counts: Ints) -> Parts:
    """Return the parts, each cut into its count of equal ones."""
    which = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    first, last = parts.first[which], parts.last[which]
    step = (last - first) / counts[which]
    final = number + 1 == counts[which]
    # The end of a part and the start of the next are computed alike.
    return Parts(
        parts.piece[which],
        first + number * step,
        np.where(final, last, first + (number + 1) * step),
    )


def _hermite(left: Floats, right: Floats, width: Floats) -> Floats:
    """Return the Bernstein coefficients, measured from the start, of Hermite polynomials.

    Args:
        left: (4, m, n): terms of the series at the start.
        right: (4, m, n): those at the end.
        width: (m,): range of the parameter.

    Returns:
        (m, 8, n): t^k has the coefficients C(i, k) / C(7, k).
    """
    form = np.zeros((left.shape[1], ORDER, left.shape[2]))
    choose = [[1.0], [1.0, 1.0], [1.0, 2.0, 1.0], [1.0, 3.0, 3.0, 1.0]]
    of_degree = (1.0, 7.0, 21.0, 35.0)
    across = right[0] - left[0]
    for i in range(4):
        for k in range(1, i + 1):
            share = (choose[i][k] / of_degree[k]) * width[:, None] ** k
            form[:, i] += share * left[k]
            form[:, ORDER - 1 - i] += share * (-1.0) ** k * right[k]
        form[:, ORDER - 1 - i] += across
    return form


def joint_records(pieces: JointPieces) -> tuple[Floats, Ints, Floats]:
    """Return the records of the pieces, the index of each, and their lengths (mm)."""
    count, n = pieces.start.shape
    at, length = np.empty(count, np.int64), np.empty(count)
    space = np.empty(LARGEST_TABLE + 4096 * joint_record_size(n))
    written: list[Floats] = []
    done = numbers = 0
    while done < count:
        after, used = write_joint_records(pieces, done, LENGTH_ACCURACY, space, at, length)
        at[done:after] += numbers
        written.append(space[:used].copy())
        numbers += used
        done = after
    return np.concatenate(written), at, length

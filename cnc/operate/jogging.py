"""Jogs: their end point and speed, and the plan of a jog on a pulse board.

A jog ends within the travel, and is slow enough to come to rest in time.

A jerk-limited stop from speed v takes

    t = 2 sqrt(v / j)      for v <= a^2 / j
    t = v / a + a / j      for faster motion

with the acceleration a and the jerk j along the direction (Biagiotti and Melchiorri, "Trajectory
Planning for Automatic Machines and Robots", section 3.4). A GRBL board has no limit of jerk: its
stop takes v / a.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import PulseSink
from cnc.machine.models import Axis, Machine
from cnc.model.blocks import Block, Held, Polyline
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import SLICE
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.session.nut_sides import ending_pushed_up
from cnc.session.pipeline import path_of
from cnc.session.run_pulses import Outcome, Progress, execute

REST_TIME = 0.2
"""Time from the release of a jog to rest, s."""
UNLIMITED = 10_000.0
"""Length of a jog of an axis without travel, mm."""
SMALLEST = 1e-6
"""Directions with a smaller part count as none; distance from the end of the travel, mm."""


@dataclass(frozen=True, slots=True)
class JogMove:
    """A straight jog.

    Attributes:
        start: Present position of the axes that move, mm.
        end: End point of the axes that move, mm.
        feed: Speed, mm/s.
    """

    start: dict[str, float]
    end: dict[str, float]
    feed: float


def stopping_speed(acceleration: float, jerk: float, seconds: float) -> float:
    """Return the highest speed, mm/s, from which a stop takes at most ``seconds``.

    Args:
        acceleration: mm/s^2.
        jerk: mm/s^3, infinite for none.
        seconds: s.
    """
    ramp = acceleration / jerk
    if seconds <= 2.0 * ramp:
        return jerk * seconds * seconds / 4.0
    return acceleration * (seconds - ramp)


def direction_of(distances: Mapping[str, float], machine: Machine) -> dict[str, float]:
    """Return the unit vector of a jog, without the axes that do not move.

    Raises:
        UsageError: ``jog-axis`` for an axis that the machine lacks, ``jog-nowhere`` for no motion.
    """
    for letter, distance in distances.items():
        if letter not in machine.axes or not math.isfinite(distance):
            hint = f"its axes are {', '.join(machine.axes)}"
            message = f"the machine has no axis {letter}, or {distance!r} is not a number"
            raise UsageError(Diagnostic("jog-axis", message, hint=hint))
    length = math.sqrt(sum(value * value for value in distances.values()))
    if not length > 0.0:
        hint = "give the distance or the direction of an axis"
        raise UsageError(Diagnostic("jog-nowhere", "the jog moves no axis", hint=hint))
    return {letter: value / length for letter, value in distances.items() if value}


def jog_speed(machine: Machine, direction: Mapping[str, float], rest: float) -> float:
    """Return the highest speed of a jog, mm/s.

    Args:
        machine: The machine.
        direction: Unit vector.
        rest: Time of the stop itself, s.
    """
    path = machine.path

    def least(name: str) -> float:
        limits = ((getattr(machine.axes[letter], name), part) for letter, part in direction.items())  # type: ignore[index]
        return min(
            (limit / abs(part) for limit, part in limits if limit is not None), default=math.inf
        )

    acceleration = min(least("max_acceleration"), path.max_tangential_acceleration or math.inf)
    jerk = min(least("max_jerk"), path.max_jerk or math.inf)
    return min(least("max_velocity"), path.max_feed, stopping_speed(acceleration, jerk, rest))


def step_move(
    machine: Machine,
    position: Mapping[str, float],
    distances: Mapping[str, float],
    feed: float | None,
    rest: float,
) -> JogMove:
    """Return a jog by a distance.

    Args:
        machine: The machine, with the travel of the board.
        position: Machine position by axis, mm.
        distances: Distance by axis, mm.
        feed: Speed that was asked for, mm/s; None for the highest.
        rest: Time of the stop itself, s.

    Raises:
        UsageError: ``soft-limit`` where the end lies outside the travel.
    """
    direction = direction_of(distances, machine)
    end = {letter: position[letter] + distances[letter] for letter in direction}
    for letter, place in end.items():
        travel = _axis(machine, letter).travel
        back = travel is not None and (place < travel[0]) == (direction[letter] > 0.0)
        if travel is not None and not travel[0] <= place <= travel[1] and not back:
            raise UsageError(_outside(letter, place, travel))
    return JogMove(
        {letter: position[letter] for letter in direction},
        end,
        _limited(feed, jog_speed(machine, direction, rest)),
    )


def endless_move(
    machine: Machine,
    position: Mapping[str, float],
    directions: Mapping[str, float],
    feed: float | None,
    rest: float,
) -> JogMove:
    """Return a jog to the end of the travel, which the release ends earlier.

    The arguments are those of :func:`step_move`; ``directions`` need not be a unit vector.

    Raises:
        UsageError: ``soft-limit`` where an axis is at the end of its travel already.
    """
    direction = direction_of(directions, machine)
    length = UNLIMITED
    for letter, part in direction.items():
        travel = _axis(machine, letter).travel
        if travel is None:
            continue
        room = (travel[1] if part > 0.0 else travel[0]) - position[letter]
        if room * part <= SMALLEST * abs(part):
            raise UsageError(_outside(letter, position[letter], travel))
        length = min(length, room / part)
    end = {letter: position[letter] + length * part for letter, part in direction.items()}
    return JogMove(
        {letter: position[letter] for letter in direction},
        end,
        _limited(feed, jog_speed(machine, direction, rest)),
    )


def _axis(machine: Machine, letter: str) -> Axis:
    return machine.axes[letter]  # type: ignore[index]


def _limited(feed: float | None, most: float) -> float:
    if feed is None:
        return most
    if not (math.isfinite(feed) and feed > 0.0):
        message, hint = f"a jog at {feed:g} mm/s is not possible", "give a speed above 0"
        raise UsageError(Diagnostic("jog-feed", message, hint=hint))
    return min(feed, most)


def _outside(letter: str, place: float, travel: tuple[float, float]) -> Diagnostic:
    name = letter.upper()
    message = (
        f"{name} would leave its travel at {place:g} mm; it is {travel[0]:g} to {travel[1]:g} mm"
    )
    return Diagnostic("soft-limit", message, hint="jog the other way, or less far")


# Jog of a pulse board: one straight plan to an end point, which a hold ends earlier.
#
#     start ──────────────────────┐ hold
#       plan at the limits         └─ the plan comes to rest on the path; the jog ends here
#
# The plan keeps the limits of velocity, acceleration and jerk, as that of a program does.

FILE = "jog"
"""The file name of a jog's block, which belongs to no program."""


def jog(
    board: PulseSink,
    machine: Machine,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    feed: float,
    *,
    control: Control,
    on_progress: Callable[[Progress], None] | None = None,
) -> Outcome:
    """Move in a straight line, until the end point or until ``control`` holds.

    Args:
        board: The board, idle.
        machine: The machine.
        start: Present position (axes,), mm.
        end: End point (axes,), mm.
        feed: Speed, mm/s.
        control: Its hold or its stop brings the motion to rest, and ends the jog.
        on_progress: Called with the progress.

    Returns:
        The outcome, with the position of the board at rest.

    Raises:
        BoardError: The board failed.
        MotionLimitError: The plan breaks a limit.
    """
    joints = Joints(machine)
    fastest = min(machine.board.max_step_rate, board.capabilities.max_step_rate)
    planner = LookAhead(machine, control, slice_s=board.capabilities.slice_s or SLICE)
    block = Polyline(FILE, 0, end[None, :], np.array([feed]), np.zeros(1, np.int32))
    path = path_of([block], machine, start, certain=False)
    pulses = ReferencePulse(
        joints.machine.steps_per_mm,
        joints.at(start),
        1e9 / fastest,
        tip_columns=joints.tip_columns,
        algorithm="crossings" if board.capabilities.separate_axes else None,
        separate_axes=board.capabilities.separate_axes,
    )
    # A jog that has failed by here leaves nothing behind for the next motion.
    if (counted := board.known_steps) is not None and board.capabilities.limit_switches:
        # Without homing the machine counts from the assumed start, as in a program.
        board.prepare_next_start(
            watched=[not closed for closed in board.switches],
            known=[steps is not None or not machine.can_home for steps in counted],
        )
    report = on_progress or (lambda _: None)
    # A joint may be faster than the tool.
    board.prepare_jog(math.inf if machine.kinematics.joints else feed)
    tips = joints.tips_from(joints.at(start))
    return execute(
        _until_held(planner.plan(path)),
        board,
        ending_pushed_up(pulses, joints),
        control=control,
        on_progress=lambda progress: report(progress.of_tip(tips)),
        ramp_down=planner.ramp_down,
    )


def _until_held(planned: Iterable[PlanChunk | Block]) -> Iterator[PlanChunk | Block]:
    """Yield a plan until it rests in a hold."""
    for item in planned:
        if isinstance(item, Held):
            return
        yield item

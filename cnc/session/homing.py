"""Homing: the position of the machine by its limit switches, one axis after the other.

       switch            seek                       1  off the switch, if it is closed at the start
    ─────┤◄──────────────────────────────────       2  to the switch at the seek speed
         │  ──────►       pull off                  3  off the switch
         ◄───────         latch                     4  to the switch at the latch speed: it closes
         │                                             at its measured position
         │  ──────►       pull off                  5  off the switch, to rest there

Moves are planned like those of a program, within the limits of velocity, acceleration and jerk.
The closing of a switch ends a move at once, as a probe does. No move is longer than the travel of
its axis. The switches of all other axes end the motion with an alarm, except switches that are
closed already: their axes do not move.

Several motors of an axis are squared at each approach (:mod:`cnc.session.homing`).

Where the joints are a linear function of the tip (CoreXY), the switches belong to the axes, and
both motors move one axis at a time. Where they are another function (a delta), or where errors are
compensated, each joint has a switch and homes alone, so a joint needs a travel.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import LineSink, PulseSink, board_error
from cnc.machine.kinematics import OfJoints
from cnc.machine.models import Homing, Machine, switch_end
from cnc.model.blocks import ROTARY_LETTERS, AxisLetter, Block, Polyline, SwitchMove
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.model.streams import GcodeLine, PackedLines
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.window import SLICE
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.session.context import SessionContext
from cnc.session.pipeline import path_of
from cnc.session.position_check import HOME, HOME_LINE, PositionCheck, recall_shift
from cnc.session.run_pulses import Progress, execute

# Homing cycles of the axes: their order, directions and places of rest.


@dataclass(frozen=True, slots=True)
class AxisHoming:
    """The homing cycle of an axis.

    Attributes:
        column: Column of the axis.
        letter: Letter of the axis.
        towards: Direction of the switch, +1 or -1.
        rest: Coordinate at the end of the cycle, mm.
        longest: Longest distance of the search for the switch, mm.
        settings: Settings of the machine file.
        offsets: Coordinate of each motor's switch less that of the first motor's, mm.
        angular: Whether the unit is the degree.
        play: Play of the nut at the place of rest, mm. At the end its motor pushes it up.
    """

    column: int
    letter: AxisLetter
    towards: int
    rest: float
    longest: float
    settings: Homing
    offsets: tuple[float, ...] = (0.0,)
    angular: bool = False
    play: float = 0.0

    @property
    def description(self) -> str:
        """Description of the cycle for the operator."""
        letter, settings = self.letter.upper(), self.settings
        direction = "up" if self.towards > 0 else "down"
        unit = "°" if self.angular else "mm"
        return (
            f"{letter}: {direction} to its switch, at most {self.longest:g} {unit} at "
            f"{settings.seek:g} {unit}/s, then once more at {settings.latch:g} {unit}/s; "
            f"{settings.pull_off:g} {unit} off it is {letter}{self.rest:g}"
            + (f"; {len(self.offsets)} motors are squared" if len(self.offsets) > 1 else "")
        )

    @classmethod
    def of(cls, machine: Machine, letter: AxisLetter) -> AxisHoming:
        """Return the cycle of an axis.

        Raises:
            UsageError: ``homing-travel``, for an axis without travel, because the search must end.
        """
        axis = machine.axes[letter]
        settings = axis.homing or Homing()
        if machine.is_sensorless(letter):
            # A slow motor does not tell that it stalls.
            settings = settings.model_copy(update={"latch": settings.seek})
        if axis.travel is None:
            hint = f"write axes.{letter}.travel = [lowest, highest] into the machine file"
            raise UsageError(
                Diagnostic(
                    "homing-travel",
                    f"{letter.upper()} has no travel, so the distance of its switch is not known",
                    hint=hint,
                )
            )
        towards = switch_end(letter, settings)
        near, far = (axis.travel[1], axis.travel[0]) if towards > 0 else axis.travel
        rest = near if settings.position is None else settings.position
        longest = abs(rest - far) + 2.0 * settings.pull_off
        return cls(
            tuple(machine.axes).index(letter),
            letter,
            towards,
            rest,
            longest,
            settings,
            tuple(motor.offset for motor in axis.motors),
            # A joint of another kinematics may have the letter of a rotary axis.
            letter in ROTARY_LETTERS and not isinstance(machine.kinematics, OfJoints),
        )


def homing_sequence(
    machine: Machine, axes: Sequence[str] = (), switches: int = 3
) -> tuple[AxisHoming, ...]:
    """Return the homing cycles of axes in their order.

    Args:
        machine: The machine.
        axes: Letters of the axes; all that have a switch if there are none.
        switches: Number of axes, from the first one, that have a switch on the board.

    Raises:
        UsageError: ``unknown-axis``, ``no-switch``, ``homing-travel``.
    """
    letters = tuple(machine.axes)
    with_switch = letters[:switches]
    named = {axis.lower() for axis in axes}
    for axis in sorted(named):
        if axis not in letters:
            raise UsageError(
                Diagnostic(
                    "unknown-axis",
                    f"the machine has no axis {axis}",
                    hint=f"its axes are {', '.join(letters)}",
                )
            )
    order = machine.homing.order if machine.homing is not None else None
    if order is None:
        order = tuple(sorted(with_switch, key=lambda letter: letter != "z"))
    wanted = [letter for letter in order if not named or letter in named]
    wanted += [letter for letter in letters if letter in named and letter not in wanted]
    for letter in wanted:
        if letter not in with_switch:
            hint = (
                f"the board has switches for {', '.join(with_switch) or 'no axis'}; "
                f"remove {letter} from the command or from homing.order"
            )
            raise UsageError(
                Diagnostic(
                    "no-switch", f"the board has no limit switch for {letter.upper()}", hint=hint
                )
            )
    return tuple(AxisHoming.of(machine, letter) for letter in wanted)


def homed_steps(
    machine: Machine,
    cycles: Iterable[AxisHoming],
    standing: Sequence[int | None],
    start: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Return the grid point (joints,) of the machine after homing.

    Args:
        machine: The machine.
        cycles: Homing cycles.
        standing: Grid point of each joint before, None where it is not known.
        start: Position (axes,) of the tip that is assumed where that of a joint is not known, mm.
    """
    joints = Joints(machine)
    scale = joints.machine.steps_per_mm
    assumed = np.round(joints.at(start) * scale).astype(np.int64)
    steps = np.array(
        [
            expected if counted is None else counted
            for counted, expected in zip(standing, assumed.tolist(), strict=True)
        ],
        np.int64,
    )
    if joints.home_alone:
        for cycle in cycles:
            steps[cycle.column] = round(cycle.rest * float(scale[cycle.column]))
        return steps
    tip = joints.tip(steps / scale)
    for cycle in cycles:
        tip[cycle.column] = on_grid(machine, cycle, cycle.rest)
    return np.rint(joints.at(tip) * scale).astype(np.int64)


def on_grid(machine: Machine, cycle: AxisHoming, place: float) -> float:
    """Return the place of an axis that is a whole number of its steps, mm."""
    scale = float(machine.steps_per_mm[cycle.column])
    return round(place * scale) / scale


# Squaring of a gantry: each motor of an axis moves to its own limit switch.
#
#       motor 1  ─────────────►│          both move until the first switch closes
#       motor 2  ─────────►        │      then each other motor moves alone, until its own closes
#                          ◄──────►
#                           at most squaring_limit: no motor moves further alone
#
# So the gantry is never pulled out of square by more than the limit. The difference between the
# motors is known after that, and a larger one is an error.


@dataclass(frozen=True, slots=True)
class Squared:
    """The result of squaring an axis.

    Attributes:
        letter: Letter of the axis.
        skew: How far each motor was ahead of the first one, in the direction of the switches, mm.
        limit: Largest difference allowed, mm.
    """

    letter: str
    skew: tuple[float, ...]
    limit: float

    @property
    def description(self) -> str:
        """Description for the operator."""
        letter = self.letter.upper()
        corrections = " and ".join(
            f"motor {number} was {abs(skew):.3f} mm {'behind' if skew < 0 else 'ahead of'} motor 1"
            for number, skew in enumerate(self.skew[1:], start=2)
        )
        return f"{letter}: {corrections} (limit {self.limit:g} mm); they are square now"


def square(mover: _Homing, cycle: AxisHoming, began: float) -> Squared | None:
    """Move each motor whose switch is open alone, until its switch closes.

    The common position of the motors stays that at the begin.

    Args:
        mover: The homing of the machine.
        cycle: The cycle of the axis, of which a switch has closed.
        began: Coordinate at the begin of the search, mm.

    Returns:
        What was found, None for an axis with one switch.

    Raises:
        BoardError: ``homing-square``, if the motors differ by more than the limit.
    """
    closed = list(mover.motor_switches(cycle))
    if len(closed) < 2:
        return None
    offsets, limit = cycle.offsets, cycle.settings.squaring_limit
    common = mover.steps.copy()
    here = mover.coordinate(cycle)
    ends = [here] * len(closed)
    # The first motor is the reference; if it is open, the one that is closed.
    first = closed.index(True) if True in closed else 0
    for motor, shut in enumerate(closed):
        if shut:
            continue
        mover.steps = common.copy()
        longest = limit + cycle.towards * (offsets[motor] - offsets[first])
        reached = longest > 0.0 and mover.go(
            cycle, longest, cycle.settings.latch, True, motor, alone=True
        )
        ends[motor] = mover.coordinate(cycle)
        if not reached:
            back = cycle.towards * (ends[motor] - here)
            if back > 0.0:
                mover.go(cycle, -back, cycle.settings.latch, None, motor, alone=True)
            raise _differ(mover, cycle, began, (first, here), (motor, ends[motor]), closed=False)
    mover.steps = common
    skew = tuple(
        -cycle.towards * (end - ends[0] - offset) for end, offset in zip(ends, offsets, strict=True)
    )
    worst = max(range(len(skew)), key=lambda motor: abs(skew[motor]))
    if abs(skew[worst]) > limit:
        raise _differ(mover, cycle, began, (0, ends[0]), (worst, ends[worst]), closed=True)
    return Squared(cycle.letter, skew, limit)


def align(mover: _Homing, cycle: AxisHoming) -> bool:
    """Move each motor whose switch has an offset alone by this offset.

    Returns:
        Whether a motor has moved.
    """
    common = mover.steps.copy()
    moved = False
    for motor, offset in enumerate(cycle.offsets):
        if offset and len(mover.motor_switches(cycle)) > 1:
            distance = -cycle.towards * offset
            mover.go(cycle, distance, cycle.settings.latch, None, motor, alone=True)
            mover.steps = common.copy()
            moved = True
    return moved


def _differ(
    mover: _Homing,
    cycle: AxisHoming,
    began: float,
    one: tuple[int, float],
    other: tuple[int, float],
    *,
    closed: bool,
) -> BoardError:
    """Return the error for two motors, each with its number and the coordinate it reached."""
    letter = cycle.letter.upper()
    (a, first), (b, second) = one, other
    tail = "closed its" if closed else "had not closed its"
    message = (
        f"the gantry of {letter} is not square: motor {a + 1} closed its switch after "
        f"{abs(first - began):.3f} mm, motor {b + 1} {tail} after {abs(second - began):.3f} mm; "
        f"axes.{cycle.letter}.homing.squaring_limit is {cycle.settings.squaring_limit:g} mm"
    )
    hint = (
        "check both switches and their wires; then push the gantry square by hand with the "
        "drivers off, and home again"
    )
    return mover.failed(message, hint, "homing-square")


STUCK = 10.0
"""Distance, in pull-offs, within which a switch that is closed at the start must open."""
LATCHES = 5.0
"""Distance, in pull-offs, within which the switch must close for the second time (GRBL:
HOMING_AXIS_LOCATE_SCALAR).
"""
FILE = "homing"
"""The file name of homing blocks, which belong to no program."""


@dataclass(frozen=True, slots=True)
class Switched:
    """Where the switch of an axis closed whose position was known.

    Attributes:
        letter: Letter of the axis.
        error: Its place, as it was counted, less that of the machine file, mm: lost steps.
    """

    letter: str
    error: float

    @property
    def description(self) -> str:
        """Description for the operator."""
        letter = self.letter.upper()
        return f"{letter}: its switch closed {self.error:+.4f} mm from where it was counted"


class _Homing:
    """State of the homing of a machine."""

    def __init__(
        self,
        board: PulseSink,
        machine: Machine,
        control: Control,
        on_progress: Callable[[Progress], None] | None,
        start: NDArray[np.float64],
        on_result: Callable[[Squared | Switched], None] | None = None,
    ) -> None:
        self.on_result = on_result or (lambda _: None)
        self.board = board
        self.machine = machine
        self.control = control
        self.on_progress = on_progress
        self.joints = Joints(machine)
        self.steps_per_mm = self.joints.machine.steps_per_mm
        standing = board.known_steps or ()
        self.known = self._known_axes([steps is not None for steps in standing])
        """Whether the position of each axis is known."""
        self.steps = homed_steps(machine, (), standing, start)
        """Grid point of the joints."""

    def motor_switches(self, cycle: AxisHoming) -> Sequence[bool]:
        """Return whether the switch of each motor of an axis is closed."""
        # The motors of linear joints move several axes, which have the switches.
        own = not self.machine.kinematics.joints
        if own:
            return self.board.motor_switches[cycle.column]
        return (self.board.switches[cycle.column],)

    def closed(self, cycle: AxisHoming) -> bool:
        """Return whether a switch of an axis is closed."""
        return any(self.motor_switches(cycle))

    def coordinate(self, cycle: AxisHoming) -> float:
        """Return the coordinate of an axis, mm."""
        return float(self.tip()[cycle.column])

    def home(self, cycle: AxisHoming) -> None:
        """Home one axis.

        Raises:
            BoardError: ``homing-switch``, where its switch does not open or close as it must.
        """
        settings, letter = cycle.settings, cycle.letter.upper()
        counted = self.known[cycle.column]
        closed = self.motor_switches(cycle)
        for motor in range(len(closed)):
            if self.motor_switches(cycle)[motor]:
                self.open(cycle, motor if len(closed) > 1 else None)
        if any(closed):
            self.off(cycle)
        self.known[cycle.column] = False
        began = self.coordinate(cycle)
        if not self.go(cycle, cycle.longest, settings.seek, until=True):
            end = "high" if cycle.towards > 0 else "low"
            hint = (
                f"check its wire, and that it is at the {end} end (axes.{cycle.letter}.homing.end)"
            )
            raise self.failed(
                f"the switch of {letter} did not close within {cycle.longest:g} mm", hint
            )
        squared = square(self, cycle, began)
        if squared is not None:
            self.on_result(squared)
        self.off(cycle)
        began = self.coordinate(cycle)
        if not self.go(cycle, LATCHES * settings.pull_off, settings.latch, until=True):
            raise self.failed(
                f"the switch of {letter} did not close a second time", "check that it is not loose"
            )
        square(self, cycle, began)
        tip = self.tip()
        place = on_grid(self.machine, cycle, cycle.rest) + cycle.towards * on_grid(
            self.machine, cycle, settings.pull_off
        )
        if counted:
            self.on_result(Switched(cycle.letter, float(tip[cycle.column]) - place))
        tip[cycle.column] = place
        take_up = cycle.play if cycle.towards > 0 else 0.0
        tip[cycle.column] -= on_grid(self.machine, cycle, take_up)
        self.steps = np.rint(self.joints.at(tip) * self.steps_per_mm).astype(np.int64)
        self.known[cycle.column] = len(closed) == 1
        self.off(cycle)
        if len(closed) > 1:
            align(self, cycle)
        if take_up:
            self.go(cycle, take_up, settings.seek)
        if len(closed) > 1:
            self.known[cycle.column] = True
            self.run(cycle)  # The board takes over the position of all motors.

    def open(self, cycle: AxisHoming, motor: int | None) -> None:
        """Move off a switch that is closed at the start; all motors of the axis move."""
        settings, letter = cycle.settings, cycle.letter.upper()
        self.known[cycle.column] = False
        if not self.go(cycle, -STUCK * settings.pull_off, settings.seek, False, motor):
            distance = STUCK * settings.pull_off
            owner = letter if motor is None else f"motor {motor + 1} of {letter}"
            raise self.failed(
                f"the switch of {owner} is still closed after a move of {distance:g} mm",
                "check its wire and its switch, and whether the axis is at its other end",
            )

    def tip(self) -> NDArray[np.float64]:
        """Return the position of the axes (axes,), mm."""
        return self.joints.tip(self.steps / self.steps_per_mm)

    def _known_axes(self, joints: Sequence[bool]) -> list[bool]:
        """Return for each axis whether the joints that move it have a known position."""
        together = self.machine.kinematics.joints
        names = tuple(self.joints.machine.axes)
        state = dict(zip(map(str, names), joints, strict=True))
        moved = self.machine.kinematics.axes if together else ()
        all_known = all(state[name] for name in together)
        return [all_known if letter in moved else state[letter] for letter in self.machine.axes]

    def with_partners(self, axes: Sequence[str], switches: int) -> Sequence[str]:
        """Return axes to home, and those that share their motors, unless their position is known.

        The position of the motors is known only when that of all their axes is.
        """
        letters = tuple(map(str, self.machine.axes))
        shared = self.machine.kinematics.axes if self.machine.kinematics.joints else ()
        if not {axis.lower() for axis in axes} & set(shared):
            return axes
        return (*axes, *(e for e in letters[:switches] if e in shared and not self._is_known(e)))

    def _is_known(self, letter: str) -> bool:
        return self.known[tuple(map(str, self.machine.axes)).index(letter)]

    def known_joints(self) -> list[bool]:
        """Return for each joint whether the axes that it moves have a known position."""
        together = self.machine.kinematics.joints
        state = dict(zip(map(str, self.machine.axes), self.known, strict=True))
        all_known = all(state[letter] for letter in self.machine.kinematics.axes)
        return [all_known if name in together else state[name] for name in self.joints.machine.axes]

    def off(self, cycle: AxisHoming) -> None:
        """Move off the switch by the pull-off."""
        self.go(cycle, -cycle.settings.pull_off, cycle.settings.seek)
        if self.closed(cycle):
            raise self.failed(
                f"the switch of {cycle.letter.upper()} is still closed "
                f"{cycle.settings.pull_off:g} mm off the position where it closed",
                f"raise axes.{cycle.letter}.homing.pull_off, or check the switch",
            )

    def go(
        self,
        cycle: AxisHoming,
        distance: float,
        feed: float,
        until: bool | None = None,
        motor: int | None = None,
        *,
        alone: bool = False,
    ) -> bool:
        """Move towards the switch.

        Args:
            cycle: The cycle.
            distance: Distance, mm; negative off the switch.
            feed: Speed, mm/s.
            until: State of the switch that ends the move, None for none.
            motor: Motor of the axis whose switch is meant, None for any.
            alone: Whether only this motor moves.

        Returns:
            Whether the switch reached that state.
        """
        end = self.tip()
        end[cycle.column] += cycle.towards * on_grid(self.machine, cycle, distance)
        block: Block
        if until is None:
            block = Polyline(FILE, 0, end[None, :], np.array([feed]), np.zeros(1, np.int32))
        else:
            block = SwitchMove(FILE, 0, end, feed, until, False, switch=cycle.column, motor=motor)
        if alone and motor is not None:
            self.board.move_alone(cycle.column, motor)
        self.run(cycle, block)
        if not isinstance(block, SwitchMove):
            return True
        return block.answer.values is not None and block.answer.values[0] == 1.0

    def run(self, cycle: AxisHoming | None, *blocks: Block) -> None:
        """Carry out blocks, from rest to rest, for the axis of ``cycle`` if there is one."""
        machine, closed = self.machine, self.board.switches
        watched = [
            not (shut or (cycle is not None and column == cycle.column))
            for column, shut in enumerate(closed)
        ]
        self.board.prepare_next_start(watched=watched, known=self.known_joints())
        start = self.tip()
        fastest = min(machine.board.max_step_rate, self.board.capabilities.max_step_rate)
        ahead = LookAhead(machine, self.control, slice_s=self.board.capabilities.slice_s or SLICE)
        planned = ahead.plan(path_of(blocks, machine, start))
        pulses = ReferencePulse(
            self.steps_per_mm,
            self.joints.at(start),
            1e9 / fastest,
            tip_columns=self.joints.tip_columns,
        )
        outcome = execute(
            planned,
            self.board,
            pulses,
            control=self.control,
            on_progress=self.on_progress,
            ramp_down=ahead.ramp_down,
        )
        self.steps = outcome.position_steps.copy()
        if not outcome.finished:
            raise HomingStopped

    def failed(self, message: str, hint: str, code: str = "homing-switch") -> BoardError:
        return board_error(code, message, hint=hint)


def _report_tip(
    on_progress: Callable[[Progress], None], joints: Joints, progress: Progress
) -> None:
    on_progress(progress.of_tip(joints.tips))


def home(
    board: PulseSink,
    machine: Machine,
    axes: Sequence[str],
    start: NDArray[np.float64],
    *,
    control: Control | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_axis: Callable[[AxisHoming], None] | None = None,
    on_result: Callable[[Squared | Switched], None] | None = None,
) -> tuple[int | None, ...]:
    """Home axes one after the other.

    Args:
        board: The board.
        machine: The machine.
        axes: Letters of the axes; all that have a switch if there are none.
        start: Position (axes,) of axes without a switch whose position is not known, mm.
        control: Requests of the operator.
        on_progress: Called with the progress.
        on_axis: Called with the cycle of each axis before it begins.
        on_result: Called with the difference that was found between the motors of an axis, and
            with the steps that an axis had lost whose position was known.

    Returns:
        Grid point of each joint, None where it is not known.

    Raises:
        UsageError: ``no-switches``, or an error of :func:`homing_sequence`.
        BoardError: The board failed. The position of the current axis is lost.
        HomingStopped: ``control`` stopped the homing.
    """
    if not board.capabilities.limit_switches:
        message = "this board has no limit switches for homing"
        hint = "name the board that has them with --board"
        raise UsageError(Diagnostic("no-switches", message, hint=hint))
    switches, joints = len(board.switches), Joints(machine)
    report = None
    if on_progress is not None:
        report = partial(_report_tip, on_progress, joints)
    plays = machine.plays_at_home
    if joints.home_alone:
        machine, start = joints.machine, joints.at(start)
    homing = _Homing(board, machine, control or Control(), report, start, on_result)
    for planned in homing_sequence(machine, homing.with_partners(axes, switches), switches):
        cycle = replace(planned, play=plays.get(planned.letter, 0.0))
        if on_axis is not None:
            on_axis(cycle)
        homing.home(cycle)
    if not all(homing.known[switches:]):
        homing.known[switches:] = [True] * (len(homing.known) - switches)
        homing.run(None)
    return tuple(
        steps if certain else None
        for steps, certain in zip(homing.steps.tolist(), homing.known_joints(), strict=True)
    )


def home_by_board(board: LineSink, axes: Sequence[str], control: Control) -> None:
    """Home a machine by the board's own cycle (``$H``); returns when it is at rest.

    Args:
        board: The board.
        axes: Letters of the axes, which must be empty.
        control: Requests of the operator.

    Raises:
        UsageError: ``board-homes-all``, for single axes.
        BoardError: The board refused or failed.
        HomingStopped: ``control`` stopped the homing.
    """
    if axes:
        hint = "give the command without axes: cncrun home"
        raise UsageError(
            Diagnostic("board-homes-all", "a GRBL board homes all its axes at once", hint=hint)
        )
    board.connect_operator(control, lambda: None)
    board.start(np.zeros(board.capabilities.axes, np.int64))
    board.send_lines(PackedLines.of([GcodeLine(HOME, HOME_LINE)]))
    if control.stopped:
        board.stop()
        raise HomingStopped
    board.finish()


def home_and_record(
    board: LineSink, machine: Machine, axes: Sequence[str], control: Control
) -> dict[str, float]:
    """Let a GRBL board home the machine, and record the position for the next run.

    Returns:
        Position of each axis, mm.

    Raises:
        BoardError, UsageError, HomingStopped: As :func:`home_by_board`.
    """
    recall_shift(board, machine)
    check = PositionCheck(board, machine, None, trusted=False)
    check.lost_until(HOME_LINE)
    check.begin()
    ended = "broken off"
    try:
        home_by_board(board, axes, control)
        board.restarted, ended = False, "end"
    except BoardError as error:
        ended = error.diagnostic.code
        # No program has this line.
        raise type(error)(replace(error.diagnostic, line=0)) from error
    finally:
        check.end(ended, None)
    return dict(zip(machine.axes, board.position, strict=False))


# Homing of the machine before a program (``--home``).

log = logging.getLogger(__name__)


def home_pulse_board(context: SessionContext, board: PulseSink) -> None:
    """Home the machine on a board that plays pulses.

    Raises:
        BoardError, HomingStopped: As :func:`cnc.session.homing.home`.
    """
    log.info("homing")
    home(
        board,
        context.reader.machine,
        (),
        context.reader.start,
        control=context.observer.control,
        on_progress=context.observer.sent,
        on_result=lambda result: log.info("%s", result.description),
    )


def home_line_board(context: SessionContext, board: LineSink) -> None:
    """Let a GRBL board home the machine; the program begins where it stands then.

    Raises:
        BoardError, HomingStopped: As :func:`home_and_record`.
    """
    reader = context.reader
    log.info("homing")
    home_and_record(board, reader.machine, (), context.observer.control)
    reader.start = np.array(board.position)
    reader.begin_at(context.options.from_line)


# Start position of a program on a board that plays pulses.


def locate(context: SessionContext, board: PulseSink) -> None:
    """Set the start position: where the board knows it is, or where homing will leave it.

    A board that does not remember its position begins where the machine file says.

    Raises:
        BoardError: ``not-homed`` if the board has lost a position that homing can find, or
            ``singular-pose`` where the machine stands.
    """
    reader, machine = context.reader, context.reader.machine
    counted, joints = board.known_steps, Joints(machine)
    if counted is None:
        return
    homed_machine = joints.machine if joints.home_alone else machine
    sequence = (
        homing_sequence(homed_machine, (), len(board.switches))
        if context.options.home and board.capabilities.limit_switches
        else ()
    )
    steps = homed_steps(machine, sequence, counted, reader.start)
    place = steps / joints.machine.steps_per_mm
    reader.start = joints.tip(place)
    if not joints.determined(place):
        names = zip(joints.machine.axes, place.tolist(), strict=True)
        where = " ".join(f"{name} = {value:g}" for name, value in names)
        message = f"the machine stands in a pose that its tip does not determine ({where})"
        hint = "move it away from the pole by hand with the drivers off, then home it"
        raise BoardError(Diagnostic("singular-pose", message, hint=hint))
    homed = {axis.letter for axis in sequence}
    lost = [
        name
        for name, place in zip(joints.machine.axes, counted, strict=True)
        if place is None and name not in homed
    ]
    if not lost or sequence:
        return
    message = f"the board has lost the position of {' '.join(lost).upper()}"
    if machine.can_home:
        cause = "it was reset, or a limit switch or the emergency stop has stopped it"
        hint = "home the machine: --home does so before the program, cncrun home alone"
        raise BoardError(Diagnostic("not-homed", f"{message}: {cause}", hint=hint))
    context.observer.warn(_assumed(message, machine, reader.start))


def _assumed(message: str, machine: Machine, start: NDArray[np.float64]) -> Diagnostic:
    """Return the warning that a position is assumed."""
    each: Sequence[float] = start.tolist()
    places = " ".join(
        f"{letter.upper()}{place:g}" for letter, place in zip(machine.axes, each, strict=True)
    )
    message = f"{message}; the program begins as if the machine stood at {places}"
    hint = "on a machine with limit switches, home it: --home, or cncrun home"
    return Diagnostic("position-assumed", message, hint=hint, severity="warning")

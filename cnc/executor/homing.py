"""Homing: the machine finds out where it stands by the limit switches of its axes, one axis after
the other.

       switch            seek                       1  off the switch, if it is closed to begin with
    ─────┤◄──────────────────────────────────       2  towards it at the seek speed, until it closes
         │  ──────►       pull off                  3  off it
         ◄───────         latch                     4  towards it at the latch speed: where it closes now is its place
         │  ──────►       pull off                  5  off it, to rest there

Every move is planned as those of a program are, within the limits of velocity, acceleration and
jerk; it is the closing of a switch that ends one at once, as a probe does. No move is longer than
what the axis has to travel. The switches of all other axes end the motion with an alarm, but for
those that are closed already: their axes don't move.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import HasLimitSwitches, LineSink, PulseSink, board_error
from cnc.executor.run import Progress, execute
from cnc.machine.models import Homing, Machine
from cnc.model.blocks import AxisLetter, Block, Polyline, SwitchMove
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.model.streams import GcodeLine
from cnc.path.build import build
from cnc.planner.lookahead import LookAhead
from cnc.planner.window import SLICE
from cnc.pulses.reference_pulse import ReferencePulse

STUCK = 10.0
"""Pull-offs after which a switch that was closed to begin with has to be open."""
LATCHES = 5.0
"""Pull-offs within which the switch has to close for the second time (GRBL:
HOMING_AXIS_LOCATE_SCALAR).
"""
HOME, HOME_LINE = "$H", 1
"""GRBL's own cycle, and the line that its answer confirms."""
FILE = "homing"
"""Where blocks of no program say that they come from."""


@dataclass(frozen=True, slots=True)
class AxisHoming:
    """How an axis goes home. towards: +1 or -1, the way to its switch; rest: mm, where it ends;
    longest: mm, to look for the switch.
    """

    column: int
    letter: AxisLetter
    towards: int
    rest: float
    longest: float
    settings: Homing

    @property
    def description(self) -> str:
        """What the axis does, in words."""
        letter, to, each = (
            self.letter.upper(),
            ("up" if self.towards > 0 else "down"),
            self.settings,
        )
        return (
            f"{letter}: {to} to its switch, at most {self.longest:g} mm at {each.seek:g} mm/s, then once more at {each.latch:g} mm/s; "
            f"{each.pull_off:g} mm off it is {letter}{self.rest:g}"
        )

    @classmethod
    def of(cls, machine: Machine, letter: AxisLetter) -> AxisHoming:
        """UsageError ``homing-travel`` for an axis without travel: the search has to end
        somewhere.
        """
        axis = machine.axes[letter]
        settings = axis.homing or Homing()
        if axis.travel is None:
            hint = f"write axes.{letter}.travel = [lowest, highest] into the machine file"
            raise UsageError(
                Diagnostic(
                    "homing-travel",
                    f"{letter.upper()} has no travel, so nobody knows how far its switch is",
                    hint=hint,
                )
            )
        high = (settings.end or ("high" if letter == "z" else "low")) == "high"
        near, far = (axis.travel[1], axis.travel[0]) if high else axis.travel
        rest = near if settings.position is None else settings.position
        longest = abs(rest - far) + 2.0 * settings.pull_off
        return cls(
            tuple(machine.axes).index(letter), letter, 1 if high else -1, rest, longest, settings
        )


def homing_sequence(
    machine: Machine, axes: Sequence[str] = (), switches: int = 3
) -> tuple[AxisHoming, ...]:
    """How the axes named go home, in the machine's order; all that have a switch if none is named.

    switches: how many of the machine's first axes have one on the board. UsageError
    ``unknown-axis``, ``no-switch``, ``homing-travel``.
    """
    letters = tuple(machine.axes)
    known = letters[:switches]
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
        order = tuple(sorted(known, key=lambda letter: letter != "z"))
    wanted = [letter for letter in order if not named or letter in named]
    wanted += [letter for letter in letters if letter in named and letter not in wanted]
    for letter in wanted:
        if letter not in known:
            hint = f"the board has switches for {', '.join(known)}; take it out, or out of homing.order"
            raise UsageError(
                Diagnostic(
                    "no-switch", f"the board has no limit switch for {letter.upper()}", hint=hint
                )
            )
    return tuple(AxisHoming.of(machine, letter) for letter in wanted)


def homed_steps(
    machine: Machine,
    ways: Iterable[AxisHoming],
    standing: Sequence[int | None],
    start: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Where the machine will stand (axes,) when it has gone these ways; where nobody knows,
    ``start``, mm, is taken for it.
    """
    steps_per_mm = machine.steps_per_mm
    taken = np.round(start * steps_per_mm).astype(np.int64)
    steps = np.array(
        [
            take if stands is None else stands
            for stands, take in zip(standing, taken.tolist(), strict=True)
        ],
        np.int64,
    )
    for way in ways:
        steps[way.column] = round(way.rest * float(steps_per_mm[way.column]))
    return steps


class _Cycle:
    """A board on its way home."""

    def __init__(
        self,
        board: PulseSink,
        switched: HasLimitSwitches,
        machine: Machine,
        control: Control,
        on_progress: Callable[[Progress], None] | None,
        start: NDArray[np.float64],
    ) -> None:
        self.board = board
        self.switched = switched
        self.machine = machine
        self.control = control
        self.on_progress = on_progress
        self.steps_per_mm = machine.steps_per_mm
        standing = switched.known_steps
        self.known = [steps is not None for steps in standing]
        self.steps = homed_steps(machine, (), standing, start)

    def closed(self, way: AxisHoming) -> bool:
        return self.switched.switches[way.column]

    def home(self, way: AxisHoming) -> None:
        """One axis. BoardError ``homing-switch`` where its switch does not do what it should."""
        settings, letter = way.settings, way.letter.upper()
        if self.closed(way):
            self.known[way.column] = False
            if not self.go(way, -STUCK * settings.pull_off, settings.seek, until=False):
                what = f"the switch of {letter} is still closed {STUCK * settings.pull_off:g} mm off it"
                raise self.failed(
                    what,
                    "is its wire broken or its switch stuck, or stands the axis at its other end?",
                )
            self.off(way)
        self.known[way.column] = False
        if not self.go(way, way.longest, settings.seek, until=True):
            hint = f"is it wired, and at the {'high' if way.towards > 0 else 'low'} end (axes.{way.letter}.homing.end)?"
            raise self.failed(
                f"the switch of {letter} has not closed within {way.longest:g} mm", hint
            )
        self.off(way)
        if not self.go(way, LATCHES * settings.pull_off, settings.latch, until=True):
            raise self.failed(
                f"the switch of {letter} has not closed a second time", "is it loose?"
            )
        self.steps[way.column] = self.in_steps(way, way.rest) + way.towards * self.in_steps(
            way, settings.pull_off
        )
        self.known[way.column] = True
        self.off(way)

    def in_steps(self, way: AxisHoming, mm: float) -> int:
        return round(mm * float(self.steps_per_mm[way.column]))

    def off(self, way: AxisHoming) -> None:
        """Off the switch by the pull-off."""
        self.go(way, -way.settings.pull_off, way.settings.seek)
        if self.closed(way):
            what = f"the switch of {way.letter.upper()} is still closed {way.settings.pull_off:g} mm off the place where it closed"
            raise self.failed(
                what, f"raise axes.{way.letter}.homing.pull_off, or look at the switch"
            )

    def go(self, way: AxisHoming, distance: float, feed: float, until: bool | None = None) -> bool:
        """Move by so many mm towards the switch; ``until`` it is closed, or open. Whether that
        came.
        """
        target = self.steps.copy()
        target[way.column] += way.towards * self.in_steps(way, distance)
        end = target / self.steps_per_mm
        block: Block
        if until is None:
            block = Polyline(FILE, 0, end[None, :], np.array([feed]), np.zeros(1, np.int32))
        else:
            block = SwitchMove(FILE, 0, end, feed, until, False, switch=way.column)
        self.run(way, block)
        if not isinstance(block, SwitchMove):
            return True
        return block.answer.values is not None and block.answer.values[0] == 1.0

    def run(self, way: AxisHoming | None, *blocks: Block) -> None:
        """Carry out blocks, from rest to rest."""
        machine, closed = self.machine, self.switched.switches
        watched = [
            not (shut or (way is not None and column == way.column))
            for column, shut in enumerate(closed)
        ]
        self.switched.prepare_next_start(watched=watched, known=self.known)
        start = self.steps / self.steps_per_mm
        fastest = min(machine.board.max_step_rate, self.board.capabilities.max_step_rate)
        ahead = LookAhead(machine, self.control, slice_s=self.board.capabilities.slice_s or SLICE)
        planned = ahead.plan(build(blocks, axes=machine.axis_names, start=start))
        pulses = ReferencePulse(self.steps_per_mm, start, 1e9 / fastest)
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

    def failed(self, what: str, hint: str) -> BoardError:
        return board_error("homing-switch", what, hint=hint)


def home(
    board: PulseSink | LineSink,
    machine: Machine,
    axes: Sequence[str],
    start: NDArray[np.float64],
    *,
    control: Control | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_axis: Callable[[AxisHoming], None] | None = None,
) -> tuple[int | None, ...]:
    """Let the axes go home, one after the other; where each axis then stands, steps, None for one
    that nobody knows of.

    axes: which, all that have a switch if none is named. Axes that have none are taken to stand
    where ``start`` (axes,) mm says, if the board does not know better. on_axis is told of every
    axis before it goes. UsageError ``no-switches`` for a board that has none; BoardError, after
    which the axis that was under way is lost; HomingStopped by ``control``.
    """
    if not isinstance(board, PulseSink) or not isinstance(board, HasLimitSwitches):
        hint = "name the board at which they are: --board stepper; a GRBL board homes by cncrun home, or a program that begins with $H"
        raise UsageError(
            Diagnostic("no-switches", "this board has no limit switches to home by", hint=hint)
        )
    switches = len(board.switches)
    cycle = _Cycle(board, board, machine, control or Control(), on_progress, start)
    for way in homing_sequence(machine, axes, switches):
        if on_axis is not None:
            on_axis(way)
        cycle.home(way)
    if not all(cycle.known[switches:]):
        cycle.known[switches:] = [True] * (len(cycle.known) - switches)
        cycle.run(None)
    return tuple(
        steps if known else None
        for steps, known in zip(cycle.steps.tolist(), cycle.known, strict=True)
    )


def home_by_board(board: LineSink, axes: Sequence[str], control: Control) -> None:
    """Let a GRBL board home the machine by its own cycle (``$H``); return when it stands at rest.

    UsageError ``board-homes-all`` for single ``axes``; BoardError where the board refuses or fails;
    HomingStopped by ``control``.
    """
    if axes:
        hint = "leave the axes out: cncrun home"
        raise UsageError(
            Diagnostic("board-homes-all", "a GRBL board homes all its axes at once", hint=hint)
        )
    board.connect_operator(control, lambda: None)
    board.start(np.zeros(board.capabilities.axes, np.int64))
    board.send_line(GcodeLine(HOME, HOME_LINE))
    if control.stopped:
        board.stop()
        raise HomingStopped
    board.finish()

"""Protocols of board drivers: pulse boards, line boards, and optional abilities.

A driver takes time-stamped chunks ahead of time, and the board plays them. The states of a board:

              start              finish
      idle ---------> running ------------> idle
                        |  stop, abort, a fault of the board
                        v
                     stopped    refuses all but stop, abort and close: BoardError `board-stopped`

An idle board takes only start, stop, abort and close. Else: BoardError `board-not-started`.

Drivers are found by name (:mod:`cnc.boards.registry`). Each driver class declares its
:class:`BoardTraits` and passes a conformance suite of ``tests/support/boards``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.operator_control import Control
from cnc.model.packed_lines import PackedLines
from cnc.model.streams import LinesSent, PulseChunk

Action = Literal[
    "spindle", "spindle backward", "surface speed", "orient", "flood", "mist", "outputs"
]
"""Actions between moves: M3, M4, G96, M19, M8, M7, M62 to M68."""
ACTIONS: frozenset[Action] = frozenset(get_args(Action))


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Capabilities of an open board.

    Attributes:
        axes: Number of axes that it can move.
        max_step_rate: Highest step rate of one axis, steps/s.
        tick_ns: Resolution of its pulse times, ns.
        pulses: Whether it takes :class:`PulseChunk`.
        lines: Whether it takes lines of G-code.
        senses: Whether it answers probes and inputs, and follows the rotation of the spindle.
        probes: Whether it answers probes, even if it has no other sensors.
        slice_s: Length of the motion slices that it should be sent, s. Short slices make holds
            fast. 0 for a board that moves nothing.
        actions: Actions that it supports between moves.
        separate_axes: Whether each axis has a queue of its own, so that moves of several axes
            together have no use.
    """

    axes: int
    max_step_rate: float
    tick_ns: float
    pulses: bool
    lines: bool
    senses: bool
    probes: bool = False
    slice_s: float = 0.0
    actions: frozenset[Action] = ACTIONS
    separate_axes: bool = False


@dataclass(frozen=True, slots=True)
class BoardTraits:
    """Facts about a kind of board that hold before one is opened; every driver class declares them.

    Attributes:
        has_port: The board is found at a port, so that ``--port`` can name one.
        takes_lines: The board takes G-code lines and plans its motion itself.
        simulated: No machine moves: the board is a model, or writes a file.
    """

    has_port: bool = True
    takes_lines: bool = False
    simulated: bool = False


class Board(Protocol):
    """The methods of all boards. All but the properties may raise BoardError."""

    @property
    def capabilities(self) -> Capabilities:
        """Capabilities of the board."""

    @property
    def confirmed_line(self) -> int:
        """Source line of the last motion or command accepted, 0 before the first."""

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Prepare for a program that begins at the grid point ``origin_steps`` (axes,)."""

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block between moves.

        Args:
            block: The block.
            time_ns: Time since the start of the program, ns.

        Returns:
            The answer to a block that has one (a probe, an input), else None.
        """

    def finish(self) -> None:
        """Wait until everything sent has been carried out."""

    def stop(self) -> None:
        """Come to rest after everything sent, and refuse later calls."""

    def abort(self) -> None:
        """Stop at once, and discard everything that waits."""

    def close(self) -> None:
        """Release the board. It cannot be used again."""


@runtime_checkable
class PulseSink(Board, Protocol):
    """A board that plays pulses."""

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point of the board (axes,)."""

    def send(self, chunk: PulseChunk) -> None:
        """Accept grid moves; returns when the board has space for more."""


OnReport = Callable[[], None]
"""A function that is called after each report of a board."""


class MachineReport(NamedTuple):
    """The last report of a board that plans its own motion.

    Attributes:
        state: The state in the words of the board, such as Run or Hold.
        work: Work position of each axis, mm; empty if it is not known.
        feed: Actual feed, mm/min; None if it is not reported.
        spindle: Speed of the spindle, rev/min; None if it is not reported.
        overrides: Of feed, traverses and spindle, per cent; None as long as they are not known.
    """

    state: str
    work: tuple[float, ...] = ()
    feed: float | None = None
    spindle: float | None = None
    overrides: tuple[int, int, int] | None = None


@runtime_checkable
class ReportsState(Protocol):
    """A board that reports its state during a run."""

    @property
    def report(self) -> MachineReport:
        """The last report."""


@runtime_checkable
class RemembersPosition(Protocol):
    """A board that remembers the position of its machine between programs."""

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis before a program, None for an axis whose position is lost."""


@runtime_checkable
class HasLimitSwitches(RemembersPosition, Protocol):
    """A board with a limit switch at each of its axes but the fourth, for homing."""

    @property
    def switches(self) -> tuple[bool, ...]:
        """Whether the switch of each axis that has one is closed now."""

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """Set conditions for the next start alone.

        Args:
            watched: Axes whose limit switches end the motion with an alarm.
            known: Axes whose position is that of the origin; the others stay unknown.
        """


@runtime_checkable
class SendsFarAhead(Protocol):
    """A board that gets so much motion ahead that a jog needs another way."""

    def prepare_jog(self, feed: float) -> None:
        """Send little ahead of the next motion alone; ``feed``: its highest speed, mm/s."""


@runtime_checkable
class SquaresGantries(HasLimitSwitches, Protocol):
    """A board on which each motor of an axis can have a limit switch of its own."""

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis that has one is closed now, in the order of motors."""

    def move_alone(self, column: int, motor: int) -> None:
        """Let only one motor of an axis move between the next start and its end."""


@runtime_checkable
class ProbesByMotion(Protocol):
    """A board that has the answer to a probe only after the motion, not from ``execute``."""

    def probe_result(self) -> tuple[float, ...] | None:
        """Return the answer to the last probe after its motion, None if there was no probe."""


@dataclass(frozen=True, slots=True)
class MotionState:
    """State of a board's motion.

    Attributes:
        line: Source line of the motion, or an earlier one.
        position: Position of each axis, mm.
        ahead: Motion that the board has not played yet, s.
    """

    line: int
    position: tuple[float, ...]
    ahead: float


@runtime_checkable
class PlaysAhead(Protocol):
    """A board that plays motion some time after it is sent."""

    @property
    def motion_state(self) -> MotionState:
        """State according to the last report of the board."""


@runtime_checkable
class Revivable(Protocol):
    """A board that takes the next program after a stop, without a new connection."""

    def revive(self) -> None:
        """Go from stopped to idle. BoardError if a fault ended the use of the board."""


@runtime_checkable
class HasButtons(Protocol):
    """A pulse board with buttons for the operator."""

    def connect_operator(self, control: Control) -> None:
        """Send the presses of the buttons to ``control`` from here on."""


@runtime_checkable
class LineSink(Board, Protocol):
    """A board that plans its own motion.

    Its ``execute`` returns when the earlier lines have been carried out.

    Attributes:
        identity: Identifies the board between runs; None for a board without stored data.
        restarted: Whether the board has just started, so that it counts from zero.
        check_only: Set before the start. The board reads the lines and reports their errors, and
            nothing moves.
    """

    @property
    def position(self) -> tuple[float, ...]:
        """Machine position of each axis in mm (degrees), as last reported."""

    @property
    def position_lost(self) -> bool:
        """Whether the motors may have lost steps, so that the reported position is unreliable."""

    @property
    def homed_position(self) -> tuple[float, ...]:
        """Machine position of each axis in mm (degrees) after homing, by the board's settings."""

    @property
    def ceiling(self) -> float | None:
        """Highest machine position of Z clear of its limit switch, mm; None without a switch."""

    @property
    def holds(self) -> bool:
        """Whether a hold has come to rest, as last reported."""

    @property
    def hold_reason(self) -> str:
        """Why the machine itself holds, and how to go on; "" if it does not."""

    @property
    def moving_line(self) -> int:
        """Source line of the move at the last report, 0 where that is not known."""

    @property
    def work_offset(self) -> tuple[float, ...]:
        """Offset of each axis that the board adds to coordinates in G54, mm."""

    @property
    def stored_offsets(self) -> Mapping[str, tuple[float, ...]]:
        """G54 to G59, G28, G30 and G92 as stored on the board, mm for each axis."""

    def limited_to_board(self, machine: Machine) -> Machine:
        """Return the machine with its travel reduced to that of the board."""

    @property
    def resolution(self) -> tuple[float, ...]:
        """Length of a step of each axis, mm (degrees)."""

    @property
    def settings(self) -> Mapping[int, float]:
        """Number and value of each setting (``$$``)."""

    @property
    def planner_blocks(self) -> int:
        """Moves that the planner of the board holds, 0 where it is not known."""

    @property
    def codes(self) -> frozenset[str]:
        """M6 (the board waits then until the operator resumes) and M7, if it has them."""

    @property
    def unused_tool_change(self) -> str:
        """What the board itself would do at an M6, in place of the pause; "" for nothing."""

    identity: str | None
    restarted: bool
    check_only: bool

    def restore_shift(self, shift: Mapping[str, float]) -> None:
        """Set the G92 that a reset has cleared; nothing where the board has one.

        Args:
            shift: Offset by axis, mm. A locked board gets it when it has been homed.

        Raises:
            BoardError: ``offset-not-kept`` where the board keeps another offset.
        """

    @property
    def buffered(self) -> int:
        """Number of lines sent that the board has not carried out yet, as far as known."""

    @property
    def lines_sent(self) -> LinesSent:
        """The lines sent since :meth:`start`."""

    @property
    def rapid_override(self) -> int:
        """Override of traverses, per cent, as last reported."""

    def now(self) -> float:
        """Return the time of the board's clock, s."""

    def connect_operator(self, control: Control, on_report: OnReport) -> None:
        """Carry out the requests of ``control`` at once from here on.

        Args:
            control: Requests of the operator.
            on_report: Function that is called after each report of the board.
        """

    def send_lines(self, lines: PackedLines) -> None:
        """Accept lines; returns when they have been sent, or when the operator stops the run."""


class FeasibilityCheck(Protocol):
    """A check before any motion whether a board can play a program."""

    def add(self, chunk: PulseChunk) -> None:
        """Add the next grid moves of the program.

        Raises:
            MotionLimitError: They exceed the limits of the board.
        """


@runtime_checkable
class ChecksFeasibility(Protocol):
    """A board that cannot play every program."""

    def feasibility_check(self) -> FeasibilityCheck:
        """Return a check of a program."""


@runtime_checkable
class SimulatesSwitches(Protocol):
    """A driver class of a simulated board that has limit switches where homing is rehearsed."""

    def with_switches(self, machine: Machine) -> PulseSink:
        """Open the board of a machine, with limit switches at its axes or joints."""


@runtime_checkable
class KnownInAdvance(Protocol):
    """A driver class that knows the capabilities of its boards without an open one."""

    def expected_capabilities(self, machine: Machine) -> Capabilities:
        """Return the capabilities of the board that this machine should have."""

    def expected_feasibility_check(self, machine: Machine) -> FeasibilityCheck:
        """Return a check of a program for the board that this machine should have."""

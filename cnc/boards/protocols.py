"""Boards: the two kinds, the properties that each states, its methods, and the faults of boards.

A driver takes time-stamped chunks ahead of time, and the board plays them. The states of a board:

              start              finish
      idle ---------> running ------------> idle
                        |  stop, abort, a fault of the board
                        v
                     stopped    refuses all but stop, abort and close: BoardError `board-stopped`

An idle board takes only start, stop, abort and close. Else: BoardError `board-not-started`.

A driver is a class that inherits from :class:`PulseSink` or :class:`LineSink`. The methods of an
ability that a board may lack have a body here: the answer of a board without it. A driver declares
its :class:`BoardTraits`, gives its :class:`Capabilities`, is found by name
(:mod:`cnc.boards.registry`), and passes a conformance suite of ``tests/support/boards``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import LinesSent, PackedLines, PulseChunk

# The faults of boards.


def board_error(code: str, message: str, *, line: int = 0, hint: str = "") -> BoardError:
    """Return a fault of the board, with its source line where it is known."""
    return BoardError(Diagnostic(code, message, line=line, hint=hint))


Action = Literal[
    "spindle", "spindle backward", "surface speed", "orient", "flood", "mist", "outputs"
]
"""Actions between moves: M3, M4, G96, M19, M8, M7, M62 to M68."""
ACTIONS: frozenset[Action] = frozenset(get_args(Action))


Kernels = Literal["segments", "step runs"]
"""Jobs of :mod:`cnc.session.kernel_jobs` that compile the kernels of a board."""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Capabilities of an open board.

    Attributes:
        axes: Number of axes that it can move.
        max_step_rate: Highest step rate of one axis, steps/s.
        tick_ns: Resolution of its pulse times, ns.
        senses: Whether it answers probes and inputs, and follows the rotation of the spindle.
        stop_latency_s: Longest time from the request of a stop to the beginning of the deceleration
            in a jog, s: motion that it plays ahead, and its link.
        probes: Whether it answers probes, even if it has no other sensors.
        slice_s: Length of the motion slices that it should be sent, s. Short slices make holds
            fast. 0 for a board that moves nothing.
        actions: Actions that it supports between moves.
        separate_axes: Whether each axis has a queue of its own, so that moves of several axes
            together have no use.
        limit_switches: Whether it has inputs for limit switches, so that the machine can be homed.
        overrides: Whether it changes the speeds of traverses and spindle at once on request.
        resumable: Whether a run that breaks off is recorded, so that it can be continued.
        kernels: Kernels that it calls.
    """

    axes: int
    max_step_rate: float
    tick_ns: float
    senses: bool
    stop_latency_s: float
    probes: bool = False
    slice_s: float = 0.0
    actions: frozenset[Action] = ACTIONS
    separate_axes: bool = False
    limit_switches: bool = False
    overrides: bool = False
    resumable: bool = True
    kernels: tuple[Kernels, ...] = ()


@dataclass(frozen=True, slots=True)
class BoardTraits:
    """Facts about a kind of board that hold before one is opened; every driver class declares them.

    Attributes:
        has_port: The board is found at a port, so that ``--port`` can name one.
        simulated: No machine moves: the board is a model, or writes a file.
        has_settings: The board has numbered settings (``$$``).
    """

    has_port: bool = True
    simulated: bool = False
    has_settings: bool = False


class SettingChange(NamedTuple):
    """A setting to write, with the texts of its values; ``before`` is "" where it is absent."""

    number: int
    before: str
    after: str


class BoardSettings(Protocol):
    """Numbered settings of a board (``$$``)."""

    @property
    def firmware(self) -> str:
        """Name and build of the firmware."""

    @property
    def values(self) -> Mapping[int, str]:
        """Value of each setting, as the board prints it."""

    def names(self) -> Mapping[int, str]:
        """Return name and unit of each setting, as far as known."""

    def differing(self, machine: Machine) -> Mapping[int, float]:
        """Return the values that a machine file implies, where the board has others."""

    def number_of(self, text: str) -> int:
        """Return the number of a setting such as ``$110``; UsageError ``setting-unknown``."""

    def parsed(self, lines: Iterable[str], file: str) -> dict[int, str]:
        """Return the settings in the lines of a file; UsageError ``setting-unknown``."""

    def changes(self, wanted: Mapping[int, str]) -> list[SettingChange]:
        """Return the settings to write, in their order.

        Raises:
            UsageError: ``setting-unknown``, ``setting-value``.
        """

    def write(self, listed: Sequence[SettingChange]) -> bool:
        """Write settings, and read them back; return whether the position is another one then.

        Raises:
            BoardError: ``board-error``, ``setting-not-kept``.
        """


class Board(Protocol):
    """The methods of all boards. All but the properties may raise BoardError."""

    traits: ClassVar[BoardTraits]

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

    def unlike(self, machine: Machine) -> list[Diagnostic]:
        """Return warnings where the board differs from the machine file, or from its firmware."""
        return []

    def numbered_settings(self) -> BoardSettings:
        """Return its settings (``$$``). UsageError ``no-settings`` for a board without them."""
        message, hint = "this board has no settings", "GRBL boards have them"
        raise UsageError(Diagnostic("no-settings", message, hint=hint))


class FeasibilityCheck(Protocol):
    """A check before any motion whether a board can play a program."""

    def add(self, chunk: PulseChunk) -> None:
        """Add the next grid moves of the program.

        Raises:
            MotionLimitError: They exceed the limits of the board.
        """


class Accelerations(NamedTuple):
    """A record of an accelerometer.

    Attributes:
        rate: Samples per second of this computer's time.
        columns: Samples (n,) by axis, mm/s^2.
        marks: Numbers of the samples at the calls of :meth:`Accelerometer.mark`.
    """

    rate: float
    columns: dict[str, NDArray[np.float64]]
    marks: tuple[int, ...] = ()


class Accelerometer(Protocol):
    """An accelerometer on a board, which records while the board moves or rests."""

    def begin(self) -> None:
        """Begin a record. BoardError ``accelerometer-fault`` if the sensor does not answer."""

    def mark(self) -> None:
        """Note the number of the present sample."""

    def end(self) -> Accelerations:
        """End the record. BoardError ``accelerometer-fault`` where samples were lost."""


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


class PulseSink(Board, Protocol):
    """A board that plays pulses."""

    takes: Literal["pulses"] = "pulses"

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> PulseSink:
        """Open the board that the machine file describes.

        Args:
            machine: The machine, whose axes are the joints.
            target: File to write, for the file board.
        """

    @classmethod
    def for_operator(cls, machine: Machine, start: Sequence[float]) -> PulseSink:
        """Open the board for an operator: a simulated one runs in real time.

        Args:
            machine: The machine, whose axes are the joints.
            start: Position of each axis of a simulated board, mm.
        """
        return cls.from_machine(machine)

    @classmethod
    def with_switches(cls, machine: Machine) -> PulseSink:
        """Open the board of a machine that is to be homed: a simulated one gets limit switches."""
        return cls.from_machine(machine.of_joints)

    @classmethod
    def expected_capabilities(cls, machine: Machine) -> Capabilities | None:
        """Return the capabilities of the machine's board without opening it; None if not known."""
        return None

    @classmethod
    def expected_feasibility_check(cls, machine: Machine) -> FeasibilityCheck | None:
        """Return a check of a program for the machine's board without opening it."""
        return None

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Grid point of the board (axes,)."""

    def send(self, chunk: PulseChunk) -> None:
        """Accept grid moves; returns when the board has space for more."""

    def revive(self) -> None:
        """Take the next program after a stop, without a new connection: go from stopped to idle.

        Raises:
            BoardError: ``board-stopped``, if a fault ended the use of the board.
        """
        message = "the board takes no program after a stop"
        raise board_error("board-stopped", message, hint="open it anew")

    def feasibility_check(self) -> FeasibilityCheck | None:
        """Return a check of a program; None for a board that can play every program."""
        return None

    def connect_operator(self, control: Control) -> None:
        """Send the presses of the board's buttons to ``control`` from here on, if it has some."""
        return

    @property
    def known_steps(self) -> tuple[int | None, ...] | None:
        """Grid point of each axis before a program, None for an axis whose position is lost.

        None for a board that does not remember the position of its machine between programs.
        """
        return None

    @property
    def motion_state(self) -> MotionState | None:
        """State by the last report; None for a board that plays motion at once."""
        return None

    def probe_result(self) -> tuple[float, ...] | None:
        """Return the answer to the last probe after its motion; None if ``execute`` gave it."""
        return None

    @property
    def accelerometer(self) -> Accelerometer | None:
        """The accelerometer; None for a board without one."""
        return None

    def prepare_jog(self, feed: float) -> None:
        """Send little ahead of the next motion alone; ``feed``: its highest speed, mm/s."""
        return

    @property
    def motor_switches(self) -> tuple[tuple[bool, ...], ...]:
        """Whether each switch of each axis that has one is closed now, in the order of motors."""
        return ()

    @property
    def switches(self) -> tuple[bool, ...]:
        """Whether a limit switch of each axis that has one is closed now."""
        return tuple(any(pressed) for pressed in self.motor_switches)

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """Set conditions for the next start alone.

        Args:
            watched: Axes whose limit switches end the motion with an alarm.
            known: Axes whose position is that of the origin; the others stay unknown.
        """
        return

    def move_alone(self, column: int, motor: int) -> None:
        """Let only one motor of an axis move between the next start and its end."""
        return


OnReport = Callable[[], None]
"""A function that is called after each report of a board."""
Condition = Literal[
    "idle", "running", "held", "jogging", "homing", "alarm", "door", "check", "sleep"
]


class MachineReport(NamedTuple):
    """The last report of a board that plans its own motion.

    Attributes:
        state: The state in the words of the board, such as Run or Hold.
        work: Work position of each axis, mm; empty if it is not known.
        feed: Actual feed, mm/min; None if it is not reported.
        spindle: Speed of the spindle, rev/min; None if it is not reported.
        overrides: Of feed, traverses and spindle, per cent; None as long as they are not known.
        condition: The state, in the same words for all boards.
        inputs: Whether each input is active, by its name.
    """

    state: str
    work: tuple[float, ...] = ()
    feed: float | None = None
    spindle: float | None = None
    overrides: tuple[int, int, int] | None = None
    condition: Condition = "idle"
    inputs: Mapping[str, bool] = {}


class LineOperation(Protocol):
    """Operation of a line board at rest. All methods may raise BoardError."""

    @property
    def homes(self) -> bool:
        """Whether the board homes the machine by a cycle of its own."""

    @property
    def homed(self) -> bool:
        """Whether the machine is homed as far as the board shows it: no alarm, no restart."""

    def begin(self) -> None:
        """Serve requests of the operator within some hundredths of a second from here on."""

    def listen(self, listener: Callable[[str, str], None]) -> None:
        """Call ``listener`` with ``->`` or ``<-`` and each line that is sent or received."""

    def refresh(self) -> None:
        """Ask for a report, and wait for it."""

    def poll(self) -> None:
        """Exchange reports for a moment; BoardError for an alarm or a restart."""

    def limits_for_jogs(self, machine: Machine) -> Machine:
        """Return the machine with the rates and accelerations of the board."""

    def jog(
        self,
        start: Mapping[str, float],
        end: Mapping[str, float],
        feed: float,
        released: Callable[[], bool],
        on_report: OnReport,
    ) -> None:
        """Move in a straight line; return at rest.

        Args:
            start: Machine position of the axes that move, mm.
            end: Its end.
            feed: Speed, mm/s.
            released: Whether the motion must end now.
            on_report: Called after each report.

        Raises:
            BoardError: ``board-error`` where the board refuses the jog, ``board-alarm``.
        """

    def read_offsets(self) -> None:
        """Read the offsets that the board keeps, if it is at rest."""

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Set the offset of a system so that the axes stand at work positions, and read it back.

        Args:
            system: G54 to G59, on some boards to G59.3, or G92.
            values: Work position of each axis, mm.

        Raises:
            UsageError: ``no-such-system``.
            BoardError: ``offset-not-kept`` where the board keeps another offset.
        """

    def unlock(self, *, at_switch: bool = True) -> None:
        """Leave an alarm without homing.

        Args:
            at_switch: Unlock although a limit switch is pressed.

        Raises:
            BoardError: ``board-locked`` at a pressed switch; ``board-error`` where the board
                refuses.
        """

    def revive(self) -> None:
        """Accept a next program. BoardError ``board-stopped`` after a fault of the link."""


class LineSink(Board, Protocol):
    """A board that plans its own motion.

    Its ``execute`` returns when the earlier lines have been carried out.

    Attributes:
        identity: Identifies the board between runs; None for a board without stored data.
        restarted: Whether the board has just started, so that it counts from zero.
        check_only: Set before the start. The board reads the lines and reports their errors, and
            nothing moves.
    """

    takes: Literal["lines"] = "lines"

    @classmethod
    def from_machine(cls, machine: Machine, target: Path | None = None) -> LineSink:
        """Open the board that the machine file describes."""

    @classmethod
    def for_operator(cls, machine: Machine, start: Sequence[float]) -> LineSink:
        """Open the board for an operator: a simulated one runs in real time."""
        return cls.from_machine(machine)

    @property
    def operation(self) -> LineOperation | None:
        """Its operation at rest; None for a board that only runs programs."""
        return None

    @property
    def report(self) -> MachineReport | None:
        """The last report; None for a board without reports."""
        return None

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

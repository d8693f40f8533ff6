"""What a board must do to be driven.

A driver takes time-stamped chunks ahead of time and plays them; nothing here waits for a pulse. The
life of a board:

              start              finish
      idle ---------> running ------------> idle
                        |  stop, abort, a fault of the board
                        v
                     stopped    refuses everything with BoardError `board-stopped`, but for stop, abort and close

Idle, a board takes only start, stop, abort and close; all else is BoardError `board-not-started`.

Drivers are found by name (:mod:`cnc.boards.registry`), and each passes the conformance suite in
``tests/drivers``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cnc.machine.models import Machine
from cnc.model.blocks import Block
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine, PulseChunk

Action = Literal[
    "spindle", "spindle backward", "surface speed", "orient", "flood", "mist", "outputs"
]
"""M3, M4, G96, M19, M8, M7, M62 to M68."""
ACTIONS: frozenset[Action] = frozenset(get_args(Action))


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What a board can take.

    axes: how many it can move. max_step_rate: steps/s of one axis. tick_ns: the grid of its pulse
    times. pulses, lines: whether it takes :class:`PulseChunk` or :class:`GcodeLine`. senses:
    whether it can answer probes and inputs, and follow the turning spindle. probes: whether it
    answers probes, though it may sense nothing else. slice_s: how much motion it is best given at a
    time, so that a hold comes soon; 0 where nothing really moves. actions: what it can do between
    moves.
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


@dataclass(frozen=True, slots=True)
class BoardTraits:
    """Facts about a kind of board that hold before one is opened; every driver class declares them.

    Attributes:
        has_port: The board is found at a port, so that ``--port`` can name one.
        takes_lines: The board takes G-code lines and plans its motion itself.
    """

    has_port: bool = True
    takes_lines: bool = False


class Board(Protocol):
    """What the two kinds of board have in common. Every method but the properties may raise
    BoardError.
    """

    @property
    def capabilities(self) -> Capabilities:
        """What the board can take."""

    @property
    def confirmed_line(self) -> int:
        """Source line of the last motion or command that the board has taken, 0 before the
        first.
        """

    def start(self, origin_steps: NDArray[np.int64]) -> None:
        """Get ready for a program that begins at the grid point ``origin_steps`` (axes,)."""

    def execute(self, block: Block, time_ns: int) -> tuple[float, ...] | None:
        """Carry out a block between moves, ``time_ns`` after the program's start. The answer to one
        that asks (a probe, an input).
        """

    def finish(self) -> None:
        """Return when everything sent has been carried out."""

    def stop(self) -> None:
        """Come to rest after what has been sent, and refuse what comes later."""

    def abort(self) -> None:
        """Stop at once, whatever is still waiting."""

    def close(self) -> None:
        """Let go of the board; the end of its life."""


@runtime_checkable
class PulseSink(Board, Protocol):
    """A board that plays pulses."""

    @property
    def position_steps(self) -> NDArray[np.int64]:
        """Where the board is on the grid, (axes,)."""

    def send(self, chunk: PulseChunk) -> None:
        """Take grid moves; returns when there is room for more."""


OnReport = Callable[[], None]


@runtime_checkable
class RemembersPosition(Protocol):
    """A board that may know where its machine stands."""

    @property
    def known_steps(self) -> tuple[int | None, ...]:
        """Where each axis stands before a program; None if the board has lost that."""


@runtime_checkable
class HasLimitSwitches(RemembersPosition, Protocol):
    """A board with a limit switch at each of its axes but the fourth, by which it can find out
    where they stand.
    """

    @property
    def switches(self) -> tuple[bool, ...]:
        """Which switches are closed now, one an axis that has one."""

    def prepare_next_start(self, *, watched: Sequence[bool], known: Sequence[bool]) -> None:
        """For the next start alone: whose switches end the motion with an alarm, and of which axes
        its origin says where they stand.
        """


@runtime_checkable
class ProbesByMotion(Protocol):
    """A board that finds out the answer to a probe by its motion, and so after ``execute``."""

    def probe_result(self) -> tuple[float, ...] | None:
        """The answer to the last probe, when its motion is over; None if there was none."""


@dataclass(frozen=True, slots=True)
class MotionState:
    """Where a board's motion is. line: no later source line than that; position: mm, one number an
    axis; ahead: s of motion it has yet.
    """

    line: int
    position: tuple[float, ...]
    ahead: float


@runtime_checkable
class PlaysAhead(Protocol):
    """A board that plays later what it is given now."""

    @property
    def motion_state(self) -> MotionState:
        """By what the board has said last."""


@runtime_checkable
class HasButtons(Protocol):
    """A board of pulses at which the operator has buttons."""

    def connect_operator(self, control: Control) -> None:
        """Whom the buttons move from here on."""


@runtime_checkable
class LineSink(Board, Protocol):
    """A board that plans for itself. Its ``execute`` returns when the lines before have been
    carried out.
    """

    @property
    def position(self) -> tuple[float, ...]:
        """Machine position in mm (degrees), one number an axis of the machine, as the board
        reported it last.
        """

    @property
    def moving_line(self) -> int:
        """Source line of the move that the board was on when it reported last, 0 where that is not
        known.
        """

    @property
    def work_offset(self) -> tuple[float, ...]:
        """What the board adds to the coordinates of a line in G54, mm, one number an axis of the
        machine.
        """

    @property
    def stored_offsets(self) -> Mapping[str, tuple[float, ...]]:
        """G54 to G59, G28, G30 and G92 as the board remembers them, mm, one number an axis of the
        machine.
        """

    def limited_to_board(self, machine: Machine) -> Machine:
        """The machine with no more travel than the board lets it have."""

    @property
    def resolution(self) -> tuple[float, ...]:
        """A step of each axis of the machine, mm (degrees)."""

    @property
    def settings(self) -> Mapping[int, float]:
        """What the board answers to ``$$``: number and value of each setting."""

    @property
    def mist(self) -> bool:
        """Whether the board has M7."""

    identity: str | None
    """What tells the board from others from one run to the next; None for a board that nothing is
    remembered of.
    """
    restarted: bool
    """Whether the board has just started, and counts from zero wherever the machine stands."""
    check_only: bool
    """Set before the start: the board reads the lines and says what is wrong with them, and nothing
    moves.
    """

    @property
    def buffered(self) -> int:
        """Lines that the board has been sent and has not carried out yet, as far as that is
        known.
        """

    @property
    def rapid_override(self) -> int:
        """Of traverses, per cent, as the board reported it last."""

    def now(self) -> float:
        """The time by the clock that the board goes by, s."""

    def connect_operator(self, control: Control, watcher: OnReport) -> None:
        """Whose wishes to carry out at once from here on, and who is told whenever the board has
        reported.
        """

    def send_line(self, line: GcodeLine) -> None:
        """Take a line; returns when it has been sent, or when the operator stops the run."""


class FeasibilityCheck(Protocol):
    """Finds out whether a board can play a program, before anything moves."""

    def add(self, chunk: PulseChunk) -> None:
        """The program's grid moves, in their order. MotionLimitError where they are more than the
        board can do.
        """


@runtime_checkable
class ChecksFeasibility(Protocol):
    """A board that can't play every program."""

    def feasibility_check(self) -> FeasibilityCheck:
        """To be shown a program."""


@runtime_checkable
class KnownInAdvance(Protocol):
    """A class of boards that can tell what its boards can take before one is there."""

    def expected_capabilities(self, machine: Machine) -> Capabilities:
        """Of the board that this machine should have."""

    def expected_feasibility_check(self, machine: Machine) -> FeasibilityCheck:
        """The same, to be shown a program."""


class BoardFactory(Protocol):
    """What the entry points of group ``cnc.boards`` name: a class of boards."""

    traits: BoardTraits

    def from_machine(self, machine: Machine, target: Path | None = None) -> PulseSink | LineSink:
        """The board that the machine file describes. ``target``: the file to write, for a board
        that is one.
        """


def board_error(code: str, message: str, *, line: int = 0, hint: str = "") -> BoardError:
    """A fault of the board, at a source line where it is known."""
    return BoardError(Diagnostic(code, message, line=line, hint=hint))

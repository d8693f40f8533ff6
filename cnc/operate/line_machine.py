"""A machine behind a GRBL board."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from cnc.boards.grbl import faults, operation
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.events import Alarmed, Started
from cnc.boards.grbl.link import POLL_FAST
from cnc.boards.grbl.settings import ACCELERATIONS, RATES
from cnc.executor.run import Progress
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.operate.events import MachineState
from cnc.operate.jogging import REST_TIME, JogMove
from cnc.operate.machines import Readings
from cnc.session.board_offsets import CHANGED, named_offsets
from cnc.session.kept_offsets import write_offsets
from cnc.session.position_check import (
    PositionCheck,
    home_by_board,
    recall_shift,
    record_shift,
)

LATENCY = 0.05
"""Time from a release to the cancel at the board, s: the link, and a turn of its loop."""
SERVED = 0.01
"""Longest time until a request of the operator is served during a run, s."""
NEVER = 2**31 - 1
"""A line that no run reaches."""
STATES: dict[str, MachineState] = {
    "Idle": "idle",
    "Run": "running",
    "Hold": "held",
    "Jog": "jogging",
    "Home": "homing",
    "Alarm": "alarm",
    "Door": "door",
    "Check": "check",
    "Sleep": "sleep",
    "Tool": "held",
}
PINS = {"P": "probe", "D": "door", "H": "hold", "R": "reset", "S": "start"}


class LineMachine:
    """A machine behind a GRBL board."""

    stops_outputs = False

    def __init__(self, board: GrblBoard, machine: Machine) -> None:
        self.board = board
        board.stream.wait = SERVED
        self._given = machine
        self.machine = board.limited_to_board(machine)
        recall_shift(board, self.machine)
        self._homes = board.info.homes
        self._homed = (
            self._homes and board.link.status is not None and board.status.state != "Alarm"
        )
        self._homed = self._homed and not board.restarted
        self.rest = REST_TIME - LATENCY

    def readings(self) -> Readings:
        """Return what the last report of the board says."""
        board, status = self.board, self.board.status
        axes = self.machine.axes
        inputs = {
            f"limit {letter}": letter.upper() in status.pins for letter in axes if letter in "xyz"
        }
        inputs |= {
            name: pin in status.pins
            for pin, name in PINS.items()
            if pin in "PD" or pin in status.pins
        }
        overrides = status.overrides
        return Readings(
            dict(zip(axes, board.position, strict=False)),
            STATES.get(status.state, "idle"),
            {str(letter): self._homed for letter in axes} if self._homes else {},
            None if status.feed is None else status.feed,
            status.speed,
            inputs,
            None if overrides is None else (*map(float, overrides),),  # type: ignore[arg-type]
        )

    def of_progress(self, progress: Progress) -> Readings:
        """Return the same during a run."""
        return self.readings()

    def poll(self) -> None:
        """Ask for the status; BoardError for an alarm or a restart."""
        link = self.board.link
        for event in link.pump(POLL_FAST, 2 * POLL_FAST):
            if isinstance(event, Alarmed):
                self._homed = False
                raise faults.alarmed(event.code, 0, self.board.info.kind)
            if isinstance(event, Started):
                self._homed = False
                self.board.restarted = True
                raise faults.restarted(0)

    def home(self, axes: Sequence[str], control: Control) -> None:
        """Let the board home all axes."""
        self._homed = False
        home_by_board(self.board, self.machine, axes, control)
        self._homed = True
        self.board.link.refresh()

    def jog(self, move: JogMove, control: Control, on_report: Callable[[Readings], None]) -> None:
        """Jog by ``$J=``; record the position for the next run."""
        board = self.board
        check = PositionCheck(board, self.machine, None, trusted=False)
        if check.doubtful:
            check.lost_until(NEVER)
        check.begin()
        ended = "broken off"
        try:
            operation.jog(
                board,
                operation.JogLine(move.start, move.end, move.feed),
                lambda: control.held or control.stopped,
                lambda: on_report(self.readings()),
            )
            ended = "stopped"
        except BoardError as error:
            ended = error.diagnostic.code
            raise
        finally:
            check.end(ended, None)

    def offsets(self) -> dict[str, dict[str, float]]:
        """Return the offsets that the board keeps, as read now."""
        operation.read_offsets(self.board)
        return {
            name: place
            for name, place in named_offsets(self.board, self.machine).items()
            if name not in ("G28", "G30")
        }

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Set an offset on the board, and read it back."""
        operation.set_work_position(self.board, system, values)
        if self.board.identity is not None:
            write_offsets(self.board.identity, named_offsets(self.board, self.machine))
            if system == "G92":
                record_shift(self.board, self.machine)

    def keep_shift(self, parameters: Mapping[int, float]) -> None:
        """Set the shift of G92 on the board, if it is another one now."""
        known = named_offsets(self.board, self.machine)
        in_effect = parameters.get(numbers.SHIFT_IN_EFFECT) == 1.0
        wanted = {
            letter: in_effect * parameters.get(numbers.SHIFT + AXIS_LETTERS.index(letter), 0.0)
            for letter in self.machine.axes
        }
        changed = [each for each in wanted if abs(wanted[each] - known["G92"][each]) > CHANGED]
        place = self.readings().position
        if changed:
            self.set_work_position(
                "G92", {each: place[each] - known["G54"][each] - wanted[each] for each in changed}
            )

    def revive(self) -> None:
        """Read the offsets again; the board accepts the next program."""
        operation.revive(self.board)

    def unlock(self, *, at_switch: bool) -> None:
        """Send ``$X``; a position that an alarm has lost stays lost."""
        operation.unlock(self.board, at_switch=at_switch)

    def for_jogs(self) -> Machine:
        """Return the machine with the rates and accelerations of the board, for jogs."""
        info, axes = self.board.info, dict(self.machine.axes)
        for letter, axis in axes.items():
            column = AXIS_LETTERS.index(letter)
            rate, acceleration = info.axis(RATES, column), info.axis(ACCELERATIONS, column)
            update: dict[str, float | None] = {"max_jerk": math.inf}
            if rate is not None:
                update["max_velocity"] = min(axis.max_velocity, rate / 60.0)
            if acceleration is not None:
                update["max_acceleration"] = acceleration
            axes[letter] = axis.model_copy(update=update)
        path = self.machine.path.model_copy(
            update={"max_tangential_acceleration": None, "max_jerk": None}
        )
        return self.machine.model_copy(update={"axes": axes, "path": path})

"""A machine behind a board that takes lines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from cnc.boards.protocols import LineOperation, LineSink
from cnc.executor.run import Progress
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
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

NEVER = 2**31 - 1
"""A line that no run reaches."""


class LineMachine:
    """A machine behind a board that takes lines.

    Args:
        board: The board.
        operation: Its operation at rest.
        machine: The machine.
    """

    stops_outputs = False
    # The board has been waited for already.
    pause = 0.001

    def __init__(self, board: LineSink, operation: LineOperation, machine: Machine) -> None:
        self.board, self._operation = board, operation
        operation.begin()
        self.machine = board.limited_to_board(machine)
        recall_shift(board, self.machine)
        self._homed = operation.homed
        self.rest = REST_TIME - board.capabilities.stop_latency_s

    def readings(self) -> Readings:
        """Return what the last report of the board says."""
        board, report = self.board, self.board.report
        position = dict(zip(map(str, self.machine.axes), board.position, strict=False))
        if report is None:
            return Readings(position)
        homed = {str(letter): self._homed for letter in self.machine.axes}
        return Readings(
            position,
            report.condition,
            homed if self._operation.homes else {},
            report.feed,
            report.spindle,
            dict(report.inputs),
            report.overrides,
        )

    def of_progress(self, progress: Progress) -> Readings:
        """Return the same during a run."""
        return self.readings()

    def poll(self) -> None:
        """Ask for the status; BoardError for an alarm or a restart."""
        try:
            self._operation.poll()
        except BoardError as error:
            if error.diagnostic.code in ("board-alarm", "board-restarted"):
                self._homed = False
            raise

    def home(self, axes: Sequence[str], control: Control) -> None:
        """Let the board home all axes."""
        self._homed = False
        home_by_board(self.board, self.machine, axes, control)
        self._homed = True
        self._operation.refresh()

    def jog(self, move: JogMove, control: Control, on_report: Callable[[Readings], None]) -> None:
        """Jog by ``$J=``; record the position for the next run."""
        board = self.board
        check = PositionCheck(board, self.machine, None, trusted=False)
        if check.doubtful:
            check.lost_until(NEVER)
        check.begin()
        ended = "broken off"
        try:
            self._operation.jog(
                move.start,
                move.end,
                move.feed,
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
        self._operation.read_offsets()
        return {
            name: place
            for name, place in named_offsets(self.board, self.machine).items()
            if name not in ("G28", "G30")
        }

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Set an offset on the board, and read it back."""
        self._operation.set_work_position(system, values)
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
        self._operation.revive()

    def unlock(self, *, at_switch: bool) -> None:
        """Send ``$X``; a position that an alarm has lost stays lost."""
        self._operation.unlock(at_switch=at_switch)

    def for_jogs(self) -> Machine:
        """Return the machine with the rates and accelerations of the board, for jogs."""
        return self._operation.limits_for_jogs(self.machine)

"""Guided measurements on a machine: the moves of a procedure, and the machine meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import NamedTuple, Protocol, TypeVar

from cnc.boards.protocols import PulseSink
from cnc.boards.registry import open_board
from cnc.machine.models import Machine
from cnc.measure.limits import Bounds, Raised, Raising, Strokes, limits
from cnc.measure.procedures import Answer, Measured, Procedure, Reading, Scale, Step, Todo, Touch
from cnc.model.blocks import AxisLetter
from cnc.model.diagnostics import BoardError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.operate.jogging import jog
from cnc.operate.machines import PulseMachine
from cnc.operate.operator_session import OperatorSession
from cnc.session import homing
from cnc.session.kernel_cache import load_kernels
from cnc.session.kernel_needs import moving_jobs
from cnc.session.program_reader import start_position

LINEAR = "xyzuvw"
T = TypeVar("T")


class Operator(Protocol):
    """The operator of a measurement, in a terminal or a console."""

    def wait(self, future: Future[T]) -> T:
        """Return a result; it may stop the machine."""

    def read(self, text: str) -> float:
        """Return a number: the last line of the text says of what."""

    def let_do(self, text: str) -> None:
        """Return when it is done."""


class Moves(NamedTuple):
    """How axes move in a measurement.

    Attributes:
        feed: Speed beside the operator, mm/s; None for the highest from which it stops in time.
        contact_feed: Speed of a first contact, mm/min.
        unhomed: Whether to move although the machine is not homed.
    """

    feed: float | None = None
    contact_feed: float = 100.0
    unhomed: bool = False


def uncompensated(machine: Machine, letters: Iterable[str], *, square: bool = False) -> Machine:
    """Return the machine as it is while axes are measured: none of their errors is compensated.

    Args:
        machine: The machine.
        letters: The axes.
        square: Whether the angles between axes are not compensated either.

    Raises:
        UsageError: ``measure-axis`` for an axis without a motor of its own.
    """
    axes = dict(machine.axes)
    for letter in letters:
        if letter not in axes or letter not in LINEAR or machine.kinematics.joints:
            names = " ".join(axes).upper()
            message = f"{letter.upper()} is no linear axis with a motor of its own"
            raise UsageError(Diagnostic("measure-axis", message, hint=f"the axes are {names}"))
        axes[letter] = axes[letter].model_copy(update={"backlash": None, "error_table": None})
    # The map has the errors of all axes in it.
    changed = {"axes": axes, "error_map": None, **({"squareness": None} if square else {})}
    return machine.model_copy(update=changed)


def scale_of(session: OperatorSession, letter: str) -> Scale:
    """Return an axis of a connected machine, where it stands now."""
    axis, homed = session.machine.joint_tables[letter], session.state.homed.get(letter, True)
    travel = (axis.travel if homed else None) or (-math.inf, math.inf)
    return Scale(letter, axis.steps_per_mm, session.state.machine[letter], travel)


def carried_out(
    procedure: Procedure, session: OperatorSession, operator: Operator, moves: Moves
) -> Measured:
    """Carry out a procedure; return its result.

    Raises:
        CncError: As the procedure, the moves, and the operator.
    """

    def answer_to(step: Step) -> Answer:
        if isinstance(step, Reading):
            return operator.read(step.text)
        if isinstance(step, Todo):
            operator.let_do(step.text)
        elif isinstance(step, Touch):
            return operator.wait(session.touch(step, moves.contact_feed, unhomed=moves.unhomed))
        else:
            way = step.place - session.state.machine[step.axis]
            if abs(way) > 0.5 / session.machine.joint_tables[step.axis].steps_per_mm:
                if step.guarded:
                    touch = session.touch(step, moves.contact_feed, unhomed=moves.unhomed)
                    operator.wait(touch)
                else:
                    way_of_axis = {step.axis: way}
                    jog = session.jog_step(way_of_axis, moves.feed, unhomed=moves.unhomed)
                    operator.wait(jog)
        return 0.0

    try:
        step = next(procedure)
        while True:
            step = procedure.send(answer_to(step))
    except StopIteration as end:
        result: Measured = end.value
        return result


# Lost steps: an axis between two homings.


@contextmanager
def opened(machine: Machine, kind: str | None, port: str | None) -> Iterator[PulseSink]:
    """Open a board with switches that plays pulses.

    Raises:
        UsageError: ``measure-board`` for a board that takes lines.
        BoardError: The board does not answer.
    """
    board = open_board(machine, kind=kind, port=port, homes=True)
    try:
        if board.takes == "lines":
            message = "a board that plans by itself does not tell where its switch closed"
            hint = "its makers describe how to raise the limits by hand, such as $110 and $120"
            raise UsageError(Diagnostic("measure-board", message, hint=hint))
        load_kernels(moving_jobs(board))
        yield board
    finally:
        board.close()


class LimitTest:
    """The search for the limits of an axis, on a board with its switch.

    Args:
        board: The board, idle.
        machine: The machine, without compensation of this axis.
        letter: The axis.
        control: Requests of the operator.
    """

    def __init__(self, board: PulseSink, machine: Machine, letter: str, control: Control) -> None:
        self.board, self.machine, self.control = board, machine, control
        self.letter: AxisLetter = next(name for name in machine.axes if name == letter)
        self._error = 0.0

    def raised(self, most: float, on_step: Callable[[Strokes], None]) -> Raised:
        """Home the axis, and raise its limits up to ``most`` times those of the machine file.

        Args:
            most: See :func:`cnc.measure.limits.limits`.
            on_step: Called before each series of strokes.

        Raises:
            CncError: As :func:`cnc.session.homing.home` and :func:`cnc.measure.limits.limits`.
            HomingStopped: The operator stopped the machine.
        """
        self._home()
        machine, axis = self.machine, self.machine.axes[self.letter]
        column = tuple(machine.axes).index(self.letter)
        place = float(PulseMachine(self.board, machine).tip()[column])
        path = machine.path
        acceleration = axis.max_acceleration or path.max_tangential_acceleration or math.inf
        jerk = axis.max_jerk or path.max_jerk or math.inf
        rate = min(machine.board.max_step_rate, self.board.capabilities.max_step_rate)
        scale = Scale(self.letter, axis.steps_per_mm, place, axis.travel or (place, place))
        procedure = limits(
            scale,
            Bounds(axis.max_velocity, acceleration, jerk),
            away=-homing.AxisHoming.of(machine, self.letter).towards,
            fastest=rate / axis.steps_per_mm,
            most=most,
        )
        return self._carried_out(procedure, on_step)

    def _carried_out(self, procedure: Raising, on_step: Callable[[Strokes], None]) -> Raised:
        answer, hit = 0.0, False
        try:
            step = next(procedure)
            while True:
                if isinstance(step, Strokes):
                    on_step(step)
                    hit = not self._strokes(step)
                else:
                    self._home()
                    answer, hit = math.inf if hit else self._error, False
                step = procedure.send(answer)
        except StopIteration as end:
            result: Raised = end.value
            return result

    def _home(self) -> None:
        """Home the axis, and note by how much its switch closed elsewhere."""

        def note(result: homing.Squared | homing.Switched) -> None:
            if isinstance(result, homing.Switched):
                self._error = result.error

        start = start_position(self.machine)
        homing.home(
            self.board, self.machine, [self.letter], start, control=self.control, on_result=note
        )

    def _strokes(self, step: Strokes) -> bool:
        """Go out and back; return False where the axis ran into a switch."""
        column = tuple(self.machine.axes).index(self.letter)
        start = PulseMachine(self.board, self.machine).tip()
        for way in step.ways:
            out = start.copy()
            out[column] += way
            for begin, end, bounds in ((start, out, step.out), (out, start, step.back)):
                machine = self._under(bounds)
                try:
                    ended = jog(
                        self.board, machine, begin, end, bounds.velocity, control=self.control
                    )
                except BoardError as error:
                    if error.diagnostic.code != "board-limit":
                        raise
                    self.board.revive()
                    return False
                if not ended.finished or self.control.stopped:
                    raise HomingStopped
        return True

    def _under(self, bounds: Bounds) -> Machine:
        """Return the machine with other limits of the axis."""
        limits_of_axis = {
            "max_velocity": bounds.velocity,
            "max_acceleration": bounds.acceleration,
            "max_jerk": None if bounds.jerk == math.inf else bounds.jerk,
        }
        # The limits along the path would hide those of the axis.
        along = {
            "max_feed": bounds.velocity,
            "max_tangential_acceleration": None,
            "max_jerk": None,
        }
        axes = dict(self.machine.axes)
        axes[self.letter] = axes[self.letter].model_copy(update=limits_of_axis)
        path = self.machine.path.model_copy(update=along)
        return self.machine.model_copy(update={"axes": axes, "path": path})

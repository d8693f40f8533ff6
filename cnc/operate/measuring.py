"""Guided measurements on a machine: the moves of a procedure, its questions, and the machine."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple

from cnc.boards.protocols import Accelerations, Accelerometer, LineSink, PulseSink
from cnc.boards.registry import open_board
from cnc.machine.models import Machine
from cnc.measure.limits import UNITS, Bounds, Raised, Raising, Strokes, limits
from cnc.measure.orders import Order, Ringing
from cnc.measure.procedures import (
    Answer,
    GoTo,
    Measured,
    Procedure,
    Reading,
    Scale,
    Shake,
    Step,
    Todo,
    Touch,
)
from cnc.model.blocks import AxisLetter
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.operate.jogging import jog
from cnc.operate.machines import PulseMachine
from cnc.operate.program_runs import DialogKind
from cnc.operate.program_session import Programs, Worker, not_connected
from cnc.planner.joints import Joints
from cnc.session import homing
from cnc.session.kernel_cache import load_kernels
from cnc.session.kernel_needs import moving_jobs
from cnc.session.program_reader import start_position

LINEAR = "xyzuvw"


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


def measured_machine(machine: Machine, order: Order) -> Machine:
    """Return the machine as it is while an order is carried out.

    Raises:
        UsageError: ``measure-axis``, ``measure-option``.
    """
    letters, touched = order.letters, order.probe is not None
    if touched and machine.kind == "lathe":
        message, hint = "the probe measures along X, not across a diameter", "use a gauge"
        raise UsageError(Diagnostic("measure-option", message, hint=hint))
    # A touch needs an axis that rests while another one moves.
    apart = {letter for letter in machine.axes if letter in LINEAR} if touched else ()
    plain = uncompensated(machine, {*letters, *apart}, square=len(letters) > 1)
    # A frame that is measured has to ring.
    return plain.model_copy(update={"vibration": {}}) if isinstance(order, Ringing) else plain


def no_probe() -> UsageError:
    """Return the error of a probe on a simulated board."""
    message, hint = "a simulated board has no probe that touches a face", "name a real board"
    return UsageError(Diagnostic("measure-board", message, hint=hint))


class _Stopped(Exception):
    """The operator has stopped the measurement."""


class Measurements:
    """The guided measurements of a session, in the thread of its worker.

    A measurement is one activity: between its readings nothing else moves the machine. Meanwhile
    the machine is the uncompensated one, however the measurement ends.

    Args:
        worker: The worker.
        programs: Runs the touches.
        jog: Moves an axis by a distance, mm.
    """

    def __init__(
        self, worker: Worker, programs: Programs, jog: Callable[[str, float, Moves], None]
    ) -> None:
        self._worker, self._programs, self._jog = worker, programs, jog
        self._down: dict[str, bool] = {}

    def measured(self, order: Order, moves: Moves) -> Measured | None:
        """Carry out an order; return its result, None where the operator stopped it.

        Raises:
            CncError: As the procedure and the moves.
        """
        worker, machine = self._worker, self._programs.machine
        plain = measured_machine(machine, order)
        if order.probe is not None and worker.machine.board.traits.simulated:
            raise no_probe()
        for letter in order.letters if order.needs_home else ():
            if not worker.view.readings.homed.get(letter, True):
                message = f"{letter.upper()} is not homed: the table is for places of the machine"
                raise UsageError(Diagnostic("measure-axis", message, hint="home the machine first"))
        with self._under(plain, moves):
            scales = [self._scale(plain, letter) for letter in order.letters]
            try:
                return carried_out(order.begin(scales), lambda step: self._answer(step, moves))
            except _Stopped:
                self._tell("measurement-stopped", "the measurement was stopped", "nothing is kept")
                return None

    def raised(self, letter: str, most: float) -> Raised:
        """Raise the limits of an axis until it loses steps, see :class:`LimitTest`.

        Raises:
            CncError: As :meth:`LimitTest.raised`.
            HomingStopped: The operator stopped the machine.
        """
        worker = self._worker
        plain = uncompensated(self._programs.machine, [letter])

        def tell(step: Strokes) -> None:
            worker.view.read(worker.machine)
            worker.notice(Diagnostic("measure-limits", strokes(step), severity="note"))

        with self._under(plain, None):
            board = takes_pulses(worker.machine.board)
            return LimitTest(board, plain, letter, worker.control).raised(most, tell)

    @contextmanager
    def _under(self, plain: Machine, moves: Moves | None) -> Iterator[None]:
        """Let the machine be the uncompensated one.

        Args:
            plain: The machine.
            moves: How nuts are pushed up at the end; None where they stay.
        """
        worker, programs = self._worker, self._programs
        before, self._down = programs.machine, {}
        self._use(plain)
        try:
            yield
        finally:
            is_up = worker.operated is not None and self._pushed_up(before, moves)
            self._use(before)
            with suppress(BoardError, UsageError):
                worker.machine.revive()
                programs.offsets_changed()
            if not is_up:
                message = "a nut with backlash may be pushed down, against what is counted"
                self._tell("measurement-home", message, "home the machine before it runs again")

    def _use(self, machine: Machine) -> None:
        """Let the board, its positions and its programs be those of a machine."""
        worker = self._worker
        self._programs.machine = machine
        if worker.operated is not None:
            worker.operated = worker.operated.under(machine)
            with suppress(BoardError):
                worker.view.read(worker.operated)

    def _pushed_up(self, machine: Machine, moves: Moves | None) -> bool:
        """Push nuts up that the measurement has left down; return whether all are up.

        At rest, motors push all nuts up: so a count of steps says where the tool is. Here their
        motors move up by the backlash, and the tool rests.
        """
        plays = Joints(machine).plays
        if moves is None:
            return not plays
        try:
            for letter, play in plays.items():
                if self._down.get(letter):
                    self._go(letter, self._place(letter) + play, moves)
        except (CncError, _Stopped):
            return False
        return True

    def _scale(self, machine: Machine, letter: str) -> Scale:
        """Return an axis where it stands now."""
        axis, homed = machine.joint_tables[letter], self._worker.view.readings.homed
        travel = (axis.travel if homed.get(letter, True) else None) or (-math.inf, math.inf)
        return Scale(letter, axis.steps_per_mm, self._place(letter), travel)

    def _place(self, letter: str) -> float:
        return self._worker.view.readings.position[letter]

    def _answer(self, step: Step, moves: Moves) -> Answer:
        """Carry out a step."""
        if isinstance(step, Reading):
            return self._asked("reading", step.text)
        if isinstance(step, Todo):
            return self._asked("todo", step.text)
        if isinstance(step, GoTo) and not step.guarded:
            self._go(step.axis, step.place, moves)
            return 0.0
        if isinstance(step, Shake):
            return self._shaken(step, moves)
        before, control = self._place(step.axis), self._worker.control
        self._refuse_stopped(control)
        if not isinstance(step, Touch) and not self._is_away(step.axis, step.place):
            return 0.0
        # A touch goes back to where it began.
        way = -step.way if isinstance(step, Touch) else step.place - before
        self._down[step.axis] = way < 0.0
        try:
            return self._programs.touch(step, moves.contact_feed, trust_position=moves.unhomed)
        except CncError:
            self._refuse_stopped(control)
            raise

    def _asked(self, kind: DialogKind, text: str) -> float:
        """Ask the operator, and wait; the worker exchanges reports with the board meanwhile."""
        worker, control = self._worker, self._worker.control
        question = worker.dialogs.begin(kind, text)
        worker.serve(
            lambda: question.answered.is_set() or control.stopped or worker.operated is None
        )
        if worker.operated is None:
            raise not_connected()
        if control.stopped or not question.yes:
            raise _Stopped
        return question.value

    def _go(self, letter: str, place: float, moves: Moves) -> None:
        """Move an axis to a place; after a hold the move goes on."""
        worker, control = self._worker, self._worker.control
        while self._is_away(letter, place):
            worker.view.paused = "hold request" if control.held else ""
            worker.serve(lambda: not control.held or control.stopped or worker.operated is None)
            worker.view.paused = ""
            self._refuse_stopped(control)
            way = place - self._place(letter)
            self._down[letter] = way < 0.0
            self._jog(letter, way, moves)
            worker.machine.revive()
            worker.view.read(worker.machine)
            self._refuse_stopped(control)
            if not control.held:
                break

    def _shaken(self, step: Shake, moves: Moves) -> Accelerations:
        """Move an axis there and back while the accelerometer records; return the record."""
        board, start = self._worker.machine.board, self._place(step.axis)
        sensor = None if board.takes == "lines" else board.accelerometer
        if sensor is None:
            message = "the board has no accelerometer"
            hint = "name its pins in [board.klipper.accelerometer], or give the record of a sensor"
            raise UsageError(Diagnostic("no-accelerometer", message, hint=hint))
        sensor.begin()
        try:
            self._rest(sensor, step.rest)
            for way in step.ways:
                for place in (start + way, start):
                    self._go(step.axis, place, moves)
                    self._rest(sensor, step.rest)
        except BaseException:
            with suppress(BoardError):
                sensor.end()
            raise
        return sensor.end()

    def _rest(self, sensor: Accelerometer, seconds: float) -> None:
        """Let the machine rest, with marks in the record; the board is served meanwhile."""
        worker, control = self._worker, self._worker.control
        sensor.mark()
        end = time.monotonic() + seconds
        worker.serve(lambda: time.monotonic() >= end or control.stopped or worker.operated is None)
        self._refuse_stopped(control)
        sensor.mark()

    def _is_away(self, letter: str, place: float) -> bool:
        steps_per_mm = self._programs.machine.joint_tables[letter].steps_per_mm
        return abs(place - self._place(letter)) > 0.5 / steps_per_mm

    def _refuse_stopped(self, control: Control) -> None:
        if control.stopped:
            raise _Stopped
        if self._worker.operated is None:
            raise not_connected()

    def _tell(self, code: str, message: str, hint: str) -> None:
        self._worker.notice(Diagnostic(code, message, hint=hint, severity="warning"))


def carried_out(procedure: Procedure, answer_to: Callable[[Step], Answer]) -> Measured:
    """Carry out a procedure; return its result.

    Args:
        procedure: The procedure.
        answer_to: Carries out a step.
    """
    try:
        step = next(procedure)
        while True:
            step = procedure.send(answer_to(step))
    except StopIteration as end:
        result: Measured = end.value
        return result


def strokes(step: Strokes) -> str:
    """Return the limits of a series of strokes as a text."""
    values = map(max, step.out, step.back)
    named = zip(values, UNITS.values(), strict=True)
    return ", ".join(f"{value:.4g} {unit}" for value, unit in named if value < math.inf)


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
        pulses = takes_pulses(board)
        load_kernels(moving_jobs(pulses, machine))
        yield pulses
    finally:
        board.close()


def takes_pulses(board: PulseSink | LineSink) -> PulseSink:
    """Return a board that plays pulses. UsageError ``measure-board`` for another one."""
    if board.takes == "lines":
        message = "a board that plans by itself does not tell where its switch closed"
        hint = "its makers describe how to raise the limits by hand, such as $110 and $120"
        raise UsageError(Diagnostic("measure-board", message, hint=hint))
    return board


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

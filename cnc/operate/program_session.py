"""The worker of an operator session, and its programs: files, lines, macros and probing."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TypeVar

from cnc.boards.port import Clock
from cnc.checks.selection import Selection
from cnc.machine.height_map import HeightMap
from cnc.machine.models import Machine
from cnc.measure.procedures import GoTo, Touch
from cnc.model import parameter_numbers as numbers
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.operate import program_runs
from cnc.operate.events import (
    Activity,
    Alarm,
    Dialog,
    EventStream,
    Finding,
    JobEnded,
    Notice,
    OffsetsChanged,
    State,
)
from cnc.operate.height_mapping import HEIGHT_MAP, Grid, PointsAgain, not_probed
from cnc.operate.machines import STATE_PERIOD, OperatedMachine
from cnc.operate.modal_memory import ModalMemory, starts_outputs
from cnc.operate.program_runs import Dialogs, RunWatch
from cnc.operate.state_view import StateView, refuse_turned, stored_rotations, work_zero
from cnc.operate.touching import MEASUREMENT, Touching
from cnc.session.options import RunOptions
from cnc.session.program_reader import MDI_NAME, InlineProgram
from cnc.session.resume import PausePlace
from cnc.session.run_pulses import Progress
from cnc.session.session import Session

# The worker of an operator session: the only thread that uses the board.
#
#     any thread ──► request ──────────────► Control ─────┐   hold, resume, stop, override
#                └─► activity ──► queue ──► worker ──► board  connect, home, jog, zero, MDI, run
#                                             │
#     ticker ──► state ten times a second     └──► events
#
# The state also comes at the beginning and the end of each activity.
#
# While nothing runs, the worker exchanges reports with the board.

log = logging.getLogger(__name__)

KEEP_ALIVE = 0.2
"""Time without a sign of life after which a jog ends, s."""
IN_PAUSE: frozenset[Activity] = frozenset({"jog", "zero", "probe"})
"""Activities that are possible while a program waits at M0 or M6."""
LIFTED = 0.01
"""Z counts as lifted from this distance below the height, mm."""
T = TypeVar("T")


class Jog(Control):
    """A jog that moves until it is released, or until its client is silent.

    Args:
        feed: Its speed, mm/s.
        keep_alive: Longest time between two signs of life, s.
        clock: Measures this time.

    Attributes:
        id: Its number.
        feed: Its speed, mm/s, which may be less than was asked for.
        ended: Done when the machine is at rest.
    """

    _numbers = itertools.count(1)

    def __init__(self, feed: float, keep_alive: float, clock: Clock) -> None:
        super().__init__()
        self.id, self.feed = next(self._numbers), feed
        self._clock, self._keep_alive = clock, keep_alive
        self._until = clock.now() + keep_alive
        self.ended: Future[None] = Future()

    def keep_alive(self) -> None:
        """Give a sign of life. It does not continue a jog that was released."""
        self._until = self._clock.now() + self._keep_alive

    def release(self) -> None:
        """Come to rest."""
        self.hold()

    @property
    def held(self) -> bool:
        """Whether the jog was released, or its client is silent."""
        if not self._held and self._clock.now() > self._until:
            self.hold()
        return self._held


class Pause:
    """A pause of the running program (M0, M6) at which the operator may use the machine.

    The run ends at the first activity. A new one goes on after the pause when the operator resumes:
    the program is read and checked again, with the zeros and tool lengths that hold then. So
    nothing that was planned with the old ones is ever sent.

    Args:
        session: The session that runs the program.
        question: The question of the pause.

    Attributes:
        place: The place of the pause; None while the run waits there itself.
        goes_on: Whether the operator has resumed; None before the answer.
        question: The question of the pause.
    """

    def __init__(self, session: Session, question: Dialog) -> None:
        self._session, self.question = session, question
        self.place: PausePlace | None = None
        self.goes_on: bool | None = None
        self._lifted = False

    @property
    def is_open(self) -> bool:
        """Whether the operator has not answered yet."""
        return self.goes_on is None

    def find_place(self) -> PausePlace:
        """Read the program up to the pause. UsageError ``pause-fixed`` if it cannot go on there."""
        try:
            return self._session.place_of_pause()
        except CncError as error:
            message = f"the program cannot go on after this pause: {error.diagnostic.message}"
            hint = "resume, or stop the program and begin it again when all is set"
            raise UsageError(Diagnostic("pause-fixed", message, hint=hint)) from error

    def refuse_unless_lifted(self, letters: Iterable[str], z: float | None) -> None:
        """Refuse moves of other axes than Z until Z was lifted: the tool may stand in the part.

        Args:
            letters: The axes that move.
            z: Machine position of Z, mm; None without the axis.

        Raises:
            UsageError: ``jog-not-lifted``.
        """
        height = None if self.place is None else self.place.height
        self._lifted |= height is None or z is None or z >= height - LIFTED
        if not self._lifted and any(letter != "z" for letter in letters):
            message = "the tool may stand in the part"
            hint = f"lift Z to {height:.3f} (machine position) first"
            raise UsageError(Diagnostic("jog-not-lifted", message, hint=hint))

    def refuse_zero(self) -> None:
        """Refuse a zero that the program would set back. UsageError ``pause-zero``."""
        if self.place is not None and self.place.sets_zeros:
            message = "the program itself has set a zero or a tool length before this pause"
            hint = "stop it, set the zero in the program, and start it again"
            raise UsageError(Diagnostic("pause-zero", message, hint=hint))


@dataclass(slots=True, eq=False)
class _Task:
    """An activity that is under way, and the requests of the operator to it."""

    activity: Activity
    control: Control


class Worker:
    """The thread that uses the board, its queue of activities, and the state of the session.

    Args:
        machine: The machine.

    Attributes:
        events: The events.
        dialogs: The open question to the operator.
        view: The state that is shown.
        operated: The machine behind the board; None without a board.
        overrides: Overrides that the next activity begins with.
        pause: The pause at which the program waits; None without one.
    """

    def __init__(self, machine: Machine) -> None:
        self.events = EventStream()
        self.dialogs = Dialogs(self.events)
        self.view = StateView(machine)
        self.operated: OperatedMachine | None = None
        self.overrides = Control()
        self.pause: Pause | None = None
        self._idle = Control()
        self._running: list[_Task] = []
        self._lock = threading.RLock()
        self._tasks: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._closed = threading.Event()
        self._worker = threading.Thread(target=self._work, daemon=True, name="machine")
        self._ticker = threading.Thread(target=self._tick, daemon=True, name="machine state")
        self._worker.start()
        self._ticker.start()

    @property
    def state(self) -> State:
        """The present state."""
        return self.view.state(self._activity, self.overrides)

    @property
    def control(self) -> Control:
        """Requests of the operator to the present activity."""
        running = self._running
        return running[-1].control if running else self._idle

    @property
    def _activity(self) -> Activity:
        running = self._running
        return running[-1].activity if running else "none"

    @property
    def _busy(self) -> bool:
        return bool(self._running)

    def close(self) -> None:
        """Release the board when the activity has ended, and end the threads."""
        self._closed.set()
        self._tasks.put(lambda: None)
        self._worker.join()
        self._ticker.join()

    @property
    def machine(self) -> OperatedMachine:
        """The machine behind the board. UsageError ``not-connected``."""
        if self.operated is None:
            raise not_connected()
        return self.operated

    def begin(
        self,
        activity: Activity,
        action: Callable[[], T],
        *,
        needs_board: bool = True,
        control: Control | None = None,
    ) -> Future[T]:
        """Hand an activity to the worker. UsageError ``machine-busy``, ``not-connected``."""
        future: Future[T] = Future()
        future.set_running_or_notify_cancel()
        with self._lock:
            if needs_board and self.operated is None:
                raise not_connected()
            pause = self.pause if activity in IN_PAUSE else None
            if self._running and (pause is None or not pause.is_open or len(self._running) > 1):
                hint = "wait for its end, or stop it"
                message = f"the machine is busy: {self._activity}"
                raise UsageError(Diagnostic("machine-busy", message, hint=hint))
            task = _Task(activity, control or self._new_control())
            self._running.append(task)
        self.events.emit_present(lambda: self.state)

        def refuse(error: CncError) -> None:
            self._fault(error)
            with self._lock:
                self._running.remove(task)
            future.set_exception(error)

        def work() -> None:
            if pause is not None and not (self.pause is pause and pause.is_open):
                refuse(_resumed())
                return
            try:
                result = action()
            except BaseException as error:
                self._fault(error)
                self._end_activity(task)
                future.set_exception(error)
            else:
                self._end_activity(task)
                future.set_result(result)

        def end_run() -> None:
            try:
                assert pause is not None
                self._end_run_at(pause)
            except CncError as error:
                refuse(error)
            else:
                self._tasks.put(work)

        if pause is None or pause.place is not None:
            self._tasks.put(work)
        else:
            # This thread takes a stop while the program is read up to its pause.
            threading.Thread(target=end_run, daemon=True, name="pause").start()
        return future

    def _end_run_at(self, pause: Pause) -> None:
        """End the run that waits at a pause, so that the worker comes to other activities."""
        place = pause.find_place()
        with self._lock:
            control = self._running[0].control if self._running else self._idle
            # The operator may have resumed or stopped meanwhile.
            if self.pause is not pause or not pause.is_open or not control.held:
                raise _resumed()
            pause.place = place
            control.stop()

    def resume(self) -> None:
        """Continue after a hold. UsageError ``machine-busy`` during a move by hand in a pause."""
        with self._lock:
            pause, running = self.pause, self._running
            if pause is None or pause.place is None:
                for task in running[:1]:
                    task.control.resume()
                self.wake()
            elif len(running) == 1:
                pause.goes_on = True
                self.wake()
            elif self._activity == "probe":
                self.control.resume()
            else:
                message, hint = f"the machine is busy: {self._activity}", "wait for its end"
                raise UsageError(Diagnostic("machine-busy", message, hint=hint))

    def stop(self) -> None:
        """Come to rest on the path, and end the activity, or all if the program is paused."""
        with self._lock:
            for task in self._running:
                task.control.stop()
                task.control.hold()
            if self.pause is not None:
                self.pause.goes_on = False
        self.dialogs.close()
        self.wake()

    def wake(self) -> None:
        """Let the worker look at once whether what it waits for is there."""
        self._tasks.put(lambda: None)

    def wait_at(self, pause: Pause) -> Control | None:
        """Carry out activities until the operator resumes the paused program.

        Returns:
            The requests to the program from then on; None if it ends here.
        """
        self.pause = pause
        self._ask(pause)
        self.view.paused = pause.question.text
        self.serve(lambda: not pause.is_open or self.operated is None)
        self.view.paused = ""
        with self._lock:
            self.pause = None
            if not pause.goes_on or self.operated is None:
                return None
            self._running[0].control = self._new_control()
            return self._running[0].control

    def _ask(self, pause: Pause) -> None:
        """Ask the question of a pause, unless it is open."""
        if self.dialogs.open is None:
            pause.question = self.dialogs.show(pause.question.kind, pause.question.text)

    def _new_control(self) -> Control:
        control = Control(self.overrides.feed_override)
        control.override_rapids(self.overrides.rapid_override)
        control.override_spindle(self.overrides.spindle_override)
        return control

    def _end_activity(self, task: _Task) -> None:
        machine = self.operated
        if machine is not None:
            try:
                machine.revive()
                self.view.read(machine)
            except BoardError as error:
                self.emit_fault(error)
                self.drop()
        with self._lock:
            self._running.remove(task)
            if not self._running:
                self.pause = None
            pause = self.pause
        if pause is None or not pause.is_open:
            self.dialogs.close()
        else:
            self._ask(pause)
        self.events.emit_present(lambda: self.state)

    def serve(self, ends: Callable[[], bool]) -> None:
        """Carry out activities, and exchange reports with the board between them, until an end."""
        while not ends():
            machine = self.operated
            try:
                task = self._tasks.get(timeout=STATE_PERIOD if machine is None else machine.pause)
            except Empty:
                if machine is not None:
                    self._poll(machine)
            else:
                task()

    def _work(self) -> None:
        self.serve(self._closed.is_set)
        self.drop()

    def _poll(self, machine: OperatedMachine) -> None:
        try:
            machine.poll()
            self.view.read(machine)
        except BoardError as error:
            self.emit_fault(error)
            try:
                machine.revive()
                self.view.read(machine)
            except BoardError:
                if error.diagnostic.code != "board-alarm":
                    self.drop()

    def _tick(self) -> None:
        due = time.monotonic()
        while not self._closed.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + STATE_PERIOD, time.monotonic())
            self.events.emit_present(lambda: self.state)

    def drop(self) -> None:
        """Release the board."""
        machine, self.operated = self.operated, None
        self.view.disconnected()
        if machine is not None:
            machine.board.close()

    def _fault(self, error: BaseException) -> None:
        if isinstance(error, HomingStopped):
            self.notice(Diagnostic("homing-stopped", str(error), severity="warning"))
        elif isinstance(error, CncError):
            self.emit_fault(error)
        else:
            log.critical("internal error", exc_info=error)
            message = f"cncrun failed: {type(error).__name__}: {error}"
            self.notice(Diagnostic("internal-error", message))

    def emit_fault(self, error: CncError) -> None:
        """Report a fault."""
        log.error("%s", error.diagnostic.render())
        self.events.emit(Alarm(finding=Finding.of(error.diagnostic)))

    def notice(self, diagnostic: Diagnostic) -> None:
        """Report a finding."""
        self.events.emit(Notice(finding=Finding.of(diagnostic)))


def _resumed() -> UsageError:
    message, hint = "the pause of the program has ended", "hold or stop the program"
    return UsageError(Diagnostic("machine-busy", message, hint=hint))


def not_connected() -> UsageError:
    """Return the fault of an activity without a board."""
    hint = "connect the board first"
    return UsageError(Diagnostic("not-connected", "no board is connected", hint=hint))


CYCLES = RunOptions(dialect="linuxcnc", selection=Selection(ignore=frozenset({"abort-possible"})))
"""Probing cycles are subroutines of LinuxCNC, whatever the dialect of the machine's programs.

They may end themselves by ABORT, which their check cannot foresee: it need not be said each time.
"""


def macro_names(folder: Path | None) -> list[str]:
    """Return the names of the macros of a folder, sorted."""
    if folder is None or not folder.is_dir():
        return []
    files = (file for file in folder.iterdir() if file.suffix in (".ngc", ".nc"))
    return sorted(file.name for file in files if file.is_file())


class Programs:
    """Runs programs on the machine of a worker, in its thread.

    Args:
        worker: The worker.
        machine: The machine, with the folders of its subroutines.
        macros: Folder of the macros; None for no macros.

    Attributes:
        machine: The machine; another one while it is measured.
    """

    def __init__(self, worker: Worker, machine: Machine, macros: Path | None) -> None:
        self._worker, self.machine, self._macros = worker, machine, macros
        self._modal = ModalMemory(has_m61=machine.program.dialect in ("auto", "linuxcnc"))

    def probe(self, line: str) -> JobEnded:
        """Run the call of a probing cycle."""
        text = f"{self._worker.view.system}\n{line}\nM2\n".encode()
        return self._run(InlineProgram(MDI_NAME, text), line, CYCLES, 1)

    def probe_grid(self, grid: Grid, *, trust_position: bool) -> HeightMap:
        """Probe a surface on a grid. UsageError ``height-map-grid`` if a contact is missing."""
        view = self._worker.view
        system = view.system
        refuse_turned(system, view.rotations, "a height map is along the axes")
        height = view.work_position(system)["z"]
        parameters = self._probed(grid.program(height), HEIGHT_MAP, trust_position=trust_position)
        work, place = view.work_position(system), view.readings.position
        return grid.height_map(
            parameters, system, {letter: place[letter] - work[letter] for letter in work}
        )

    def probe_points(self, again: PointsAgain) -> HeightMap:
        """Probe points of a height map again. UsageError ``height-map-grid``."""
        view = self._worker.view
        system = view.system
        refuse_turned(system, view.rotations, "a height map is along the axes")
        again.check(system, work_zero(view.offsets, system))
        program = again.program(view.work_position(system)["z"])
        return again.height_map(self._probed(program, HEIGHT_MAP))

    def touch(self, step: Touch | GoTo, feed: float, *, trust_position: bool) -> tuple[float, ...]:
        """Carry out a step of a measurement with the probe; return the contacts, mm.

        Args:
            step: The step.
            feed: Speed of a first contact, mm/min.
            trust_position: The position that the board reports is right.

        Raises:
            CncError: ``measure-contact`` if a contact is missing, or if one is in the way.
        """
        view = self._worker.view
        refuse_turned(view.system, view.rotations, "a measurement is along the axes")
        touching = Touching(step, view.readings.position[step.axis], feed)
        parameters = self._probed(touching.program, MEASUREMENT, trust_position=trust_position)
        return touching.contacts(parameters)

    def _probed(self, text: str, name: str, *, trust_position: bool = False) -> dict[int, float]:
        """Return the parameters after a program of contacts, which begins in the system in use."""
        program = InlineProgram(MDI_NAME, f"{self._worker.view.system}\n{text}".encode())
        parameters: dict[int, float] = {}
        options = replace(CYCLES, trust_position=trust_position)
        ended = self._run(program, name, options, 1, parameters.update)
        if ended.outcome != "done":
            raise not_probed(ended, name)
        return parameters

    def mdi(self, line: str, *, trust_position: bool) -> JobEnded:
        """Run a line, with the modal state of the lines before it."""
        before = self._modal.before(line)
        text = f"{before}\n{line}\n" if before else f"{line}\n"
        skipped = before.count("\n") + 1 if before else 0
        parameters: dict[int, float] = {}
        program = InlineProgram(MDI_NAME, text.encode())
        options = RunOptions(trust_position=trust_position)
        ended = self._run(program, MDI_NAME, options, skipped, parameters.update)
        # A line that was stopped has set its modes before it moved.
        if ended.outcome != "failed":
            self._after_line(line, parameters)
        return ended

    def _after_line(self, line: str, parameters: Mapping[int, float]) -> None:
        """Keep the modes that a line leaves, and report those that end with it."""
        memory, machine = self._modal, self._worker.machine
        if not (memory.note_parameters(parameters) & memory.note(line)):
            message = "the modes before this line are forgotten: units, distance, tool length"
            self._warn(message, "the next line begins with the defaults of a program")
        if memory.lost:
            message = f"{' and '.join(memory.lost)} was in effect for this line only"
            self._warn(message, "write it into each line that needs it, or into a program")
        if machine.stops_outputs and starts_outputs(line):
            message = "spindle and coolant stop at the end of the line on this board"
            self._warn(message, "start them in the program that needs them")
        self._worker.view.modes = memory.modes
        with suppress(BoardError):
            machine.keep_shift(parameters)
            self.offsets_changed()

    def _warn(self, message: str, hint: str) -> None:
        self._worker.notice(Diagnostic("mdi-modes", message, hint=hint, severity="warning"))

    def macro(self, name: str) -> Path:
        """Return the file of a macro. UsageError ``no-such-macro``."""
        names = macro_names(self._macros)
        if self._macros is None or name not in names:
            hint = f"macros are {', '.join(names) or 'none'}"
            raise UsageError(Diagnostic("no-such-macro", f"there is no macro {name}", hint=hint))
        return self._macros / name

    def run(self, program: Path, name: str, options: RunOptions) -> JobEnded:
        """Run a program; the modes of the lines before it end, because it may change the tool."""
        self.forget_modes()
        return self._run(program, name, options, 0)

    def forget_modes(self) -> None:
        """Let the next entered line begin with the modes of a program."""
        self._modal.forget()
        self._worker.view.modes = ""

    def _run(
        self,
        program: Path | InlineProgram,
        name: str,
        options: RunOptions,
        skipped: int,
        on_end: Callable[[Mapping[int, float]], object] | None = None,
    ) -> JobEnded:
        shown = self._worker.view.begin(name)
        try:
            ended = self._parts(program, name, options, skipped, on_end)
        except CncError as error:
            ended = program_runs.failed(error, name)
        finally:
            self._worker.view.end(shown)
        self._worker.events.emit(ended)
        # The end of the activity reports a board that has failed; the outcome of the run stays.
        with suppress(BoardError):
            self._worker.machine.revive()
            self.offsets_changed()
        return ended

    def _parts(
        self,
        program: Path | InlineProgram,
        name: str,
        options: RunOptions,
        skipped: int,
        on_end: Callable[[Mapping[int, float]], object] | None,
    ) -> JobEnded:
        """Run a program; a pause at which the operator uses the machine divides it into parts."""
        worker, machine, control = self._worker, self._worker.machine, self._worker.control
        view, seconds = worker.view, 0.0
        pause: Pause | None = None

        def on_progress(progress: Progress) -> None:
            view.progress(progress, machine.of_progress(progress))

        while True:
            reached: Pause | None = None

            def at_pause(question: Dialog | None) -> None:
                nonlocal reached
                # A cycle that runs at a pause has no pause of its own.
                if worker.pause is None or worker.pause.place is None:
                    reached = None if question is None else Pause(session, question)  # noqa: B023
                    worker.pause = reached

            watch = RunWatch(name, worker.events, worker.dialogs, on_progress, at_pause, skipped)
            session = Session(
                program,
                self.machine,
                options,
                callbacks=watch.callbacks(),
                control=control,
                after=None if pause is None else pause.place,
            )
            report, is_last = session.run(machine.board, view.board), False
            # A run that does not go on has ended at its pause.
            if pause is None or session.moved:
                seconds += report.duration_s
                ended = replace(program_runs.ended(report, name, skipped), seconds=seconds)
            if reached is not None and reached.place is not None and not report.faults:
                pause = reached
            elif pause is not None and report.faults and not (session.moved or control.stopped):
                # Such as a new zero that leads out of the travel: it can be set again.
                pause.goes_on = None
                for fault in report.faults:
                    worker.emit_fault(fault)
            else:
                is_last = True
            resumed = None if is_last or pause is None else self._wait_at(pause)
            if resumed is None:
                break
            # The reason of the pause is no longer that of the state.
            view.begin(name)
            control, options = resumed, replace(options, home=False, from_line=None)
        self._tell_lost_rotation(session.parameters)
        if on_end is not None:
            on_end(session.parameters)
        return ended

    def _tell_lost_rotation(self, parameters: Mapping[int, float]) -> None:
        """Tell of a rotation that a program has set, if no parameter file keeps it."""
        stored = stored_rotations(self.machine)
        for k, name in enumerate(numbers.SYSTEMS):
            angle = parameters.get(numbers.origin(k) + numbers.ROTATION, 0.0)
            if angle != stored.get(name, 0.0) and self.machine.program.parameters is None:
                message = f"the rotation of {name} by {angle:g} degrees has ended: it is not kept"
                hint = "write parameters = 'machine.var' under [program]"
                self._worker.notice(
                    Diagnostic("rotation-not-kept", message, hint=hint, severity="warning")
                )

    def _wait_at(self, pause: Pause) -> Control | None:
        """Let the operator use the machine; return as :meth:`Worker.wait_at`."""
        self._worker.machine.revive()
        self.offsets_changed()
        return self._worker.wait_at(pause)

    def offsets_changed(self) -> dict[str, dict[str, float]]:
        """Read the offsets again, and report them."""
        machine = self._worker.machine
        offsets = machine.offsets()
        self._worker.view.read(machine)
        rotations = stored_rotations(self.machine)
        self._worker.view.offsets, self._worker.view.rotations = offsets, rotations
        self._worker.events.emit(OffsetsChanged(offsets=offsets, rotations=rotations))
        return offsets

"""The operator session: it operates one machine, from the connection to the end.

It is put together from parts: the worker carries out one activity at a time, and
programs run there (:mod:`cnc.operate.program_session`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

from cnc.boards.port import Clock, SystemClock
from cnc.boards.protocols import LineSink, PulseSink
from cnc.machine.height_map import HeightMap
from cnc.machine.models import Machine
from cnc.measure.limits import Raised
from cnc.measure.orders import Order
from cnc.measure.procedures import Measured
from cnc.model.diagnostics import CncError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.operate import jogging
from cnc.operate.events import (
    ConsoleLine,
    Event,
    JobEnded,
    Listener,
    State,
)
from cnc.operate.height_mapping import Grid, PointsAgain
from cnc.operate.machines import open_live, operated
from cnc.operate.measuring import Measurements, Moves, measured_machine, uncompensated
from cnc.operate.program_session import KEEP_ALIVE, Jog, Programs, Worker
from cnc.operate.state_view import refuse_turned, turned
from cnc.session.options import RunOptions

# Numbered settings (``$$``) of the board of a session.


@dataclass(frozen=True, slots=True)
class BoardSetting:
    """A setting.

    Attributes:
        number: Its number.
        value: Its value, as the board prints it.
        name: Its name; "" if it is not known.
        unit: Its unit; "" without one.
        machine_file: The value that the machine file implies, where that is another one.
    """

    number: int
    value: str
    name: str
    unit: str
    machine_file: float | None


def read_settings(board: PulseSink | LineSink, machine: Machine) -> list[BoardSetting]:
    """Return the settings of a board by number. UsageError ``no-settings``."""
    settings = board.numbered_settings()
    names, other = settings.names(), settings.differing(machine)
    listed = []
    for number, value in sorted(settings.values.items()):
        name, _, unit = names.get(number, "").partition(", ")
        listed.append(BoardSetting(number, value, name, unit, other.get(number)))
    return listed


def change_setting(board: PulseSink | LineSink, number: int, value: str) -> None:
    """Write a setting, and read it back.

    Raises:
        UsageError: ``no-settings``, ``setting-unknown``.
        BoardError: ``board-error``, ``setting-not-kept``.
    """
    settings = board.numbered_settings()
    settings.write(settings.changes({number: value}))


Offsets = dict[str, dict[str, float]]


class JogBegun(NamedTuple):
    """A jog that lasts until its release.

    Attributes:
        id: Its number.
        feed: Its speed, mm/s, which may be less than was asked for.
    """

    id: int
    feed: float


def begin_jog(
    session: OperatorSession,
    directions: Mapping[str, float],
    feed: float | None = None,
    *,
    unhomed: bool = False,
    keep_alive: float = KEEP_ALIVE,
) -> JogBegun:
    """Begin a jog as :meth:`OperatorSession.jog`; ``keep_jog`` and ``release_jog`` end it."""
    jog = session.jog(directions, feed, unhomed=unhomed, keep_alive=keep_alive)
    return JogBegun(jog.id, jog.feed)


def answered(action: Callable[[], Any]) -> Future[Any]:
    """Return the result of an action as a future."""
    future: Future[Any] = Future()
    future.set_running_or_notify_cancel()
    try:
        answer = action()
    except Exception as error:
        future.set_exception(error)
    else:
        future.set_result(answer)
    return future


MOST_HISTORY = 1000
"""Entered lines that are kept."""
MOST_POSITION = 100_000.0
"""Farthest work position that a zero can set, mm: 100 m."""
P = ParamSpec("P")
T = TypeVar("T")


class OperatorSession:
    """Operates one machine.

    Activities return a future. It has the result, or the fault. Faults also come as events.

    Args:
        machine: The machine.
        macros: Folder of the macros; None for no macros.
        subroutines: Further folders of subroutines.
        clock: Measures the time between the signs of life of a jog; None for the real time.

    Attributes:
        events: The events.
        machine: The machine.
        history: Lines entered by :meth:`mdi`, the oldest first.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        macros: Path | None = None,
        subroutines: Sequence[Path] = (),
        clock: Clock | None = None,
    ) -> None:
        self.machine = self.with_folders(machine, macros, subroutines)
        self.history: list[str] = []
        self._clock = clock or SystemClock()
        self._worker = Worker(self.machine)
        self._programs = Programs(self._worker, self.machine, macros)
        self._measurements = Measurements(self._worker, self._programs, self._measuring_move)
        self._jog: Jog | None = None
        self.events = self._worker.events

    @staticmethod
    def with_folders(machine: Machine, macros: Path | None, subroutines: Sequence[Path]) -> Machine:
        """Return the machine with the folders in which programs find their subroutines."""
        folders = [*machine.program.subroutines, *subroutines]
        if macros is not None:
            folders.append(macros)
        program = machine.program.model_copy(update={"subroutines": tuple(folders)})
        return machine.model_copy(update={"program": program})

    def ask(
        self,
        method: Callable[Concatenate[OperatorSession, P], T],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> Future[T]:
        """Call a method of the session; return what it returns or raises."""
        return answered(lambda: method(self, *args, **kwargs))

    def __enter__(self) -> OperatorSession:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Come to rest, release the board, and end the session."""
        self.stop()
        self._worker.close()

    # Events and state

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` with each event; the result ends this."""
        return self.events.listen(listener)

    @property
    def state(self) -> State:
        """The present state."""
        return self._worker.state

    @property
    def dialog(self) -> Event | None:
        """The open question to the operator."""
        return self._worker.dialogs.open

    @property
    def offsets(self) -> dict[str, dict[str, float]]:
        """Offsets by name and axis, mm; empty without a board."""
        return self._worker.view.offsets

    @property
    def rotations(self) -> dict[str, float]:
        """Rotations of the coordinate systems that are turned, degrees."""
        return self._worker.view.rotations

    @property
    def limited_machine(self) -> Machine:
        """The machine with the travel of the board, and the kind of the board."""
        machine = self.machine if self._worker.operated is None else self._worker.operated.machine
        board = machine.board.model_copy(
            update={"kind": self._worker.view.board or machine.board.kind}
        )
        return machine.model_copy(update={"board": board})

    @property
    def travel(self) -> dict[str, tuple[float, float] | None]:
        """Travel of each axis, mm, as the board limits it."""
        machine = self.machine if self._worker.operated is None else self._worker.operated.machine
        return {str(letter): axis.travel for letter, axis in machine.axes.items()}

    # Connection

    def connect(self, board: str | None = None, port: str | None = None) -> Future[None]:
        """Open a board; None for that of the machine file.

        Raises:
            UsageError: ``machine-busy``, ``board-connected``.
        """
        name = board or self.machine.board.kind

        def connect() -> None:
            if self._worker.operated is not None:
                message, hint = "a board is connected already", "disconnect it first"
                raise UsageError(Diagnostic("board-connected", message, hint=hint))
            opened = open_live(self.machine, name, port)
            try:
                machine = operated(opened, self.machine)
            except CncError:
                opened.close()
                raise
            if opened.takes == "lines" and opened.operation is not None:
                opened.operation.listen(self._console)
            self._worker.operated = machine
            self._programs.forget_modes()
            self._worker.view.connected(name, machine)
            self._programs.offsets_changed()

        return self._worker.begin("connect", connect, needs_board=False)

    def disconnect(self) -> Future[None]:
        """Release the board."""
        return self._worker.begin("connect", self._worker.drop, needs_board=False)

    # Activities

    def home(self, axes: Sequence[str] = ()) -> Future[None]:
        """Home axes; all that have a switch if there are none."""

        def home() -> None:
            self._worker.machine.home(tuple(axes), self._worker.control)
            self._worker.view.read(self._worker.machine)

        return self._worker.begin("home", home)

    def unlock(self, *, at_switch: bool = True) -> Future[None]:
        """Leave an alarm without homing: a position that it has lost stays lost.

        Args:
            at_switch: Unlock although a limit switch is pressed, to jog off it.
        """

        def unlock() -> None:
            self._worker.machine.unlock(at_switch=at_switch)
            self._worker.view.read(self._worker.machine)

        return self._worker.begin("unlock", unlock)

    def jog_step(
        self, distances: Mapping[str, float], feed: float | None = None, *, unhomed: bool = False
    ) -> Future[None]:
        """Move by a distance.

        Args:
            distances: By axis, mm.
            feed: Speed, mm/s; None for the highest from which the machine stops in time.
            unhomed: Move although the machine is not homed, so that no limit is known.

        Raises:
            UsageError: ``machine-busy``, ``soft-limit``, ``jog-unhomed``, ``jog-axis``,
                ``jog-nowhere``, ``jog-feed``.
        """
        plan = partial(self._jog_move, jogging.step_move, distances, feed, unhomed=unhomed)
        plan()
        control = Control()
        return self._worker.begin(
            "jog", lambda: self._carry_out_jog(plan, control), control=control
        )

    def jog(
        self,
        directions: Mapping[str, float],
        feed: float | None = None,
        *,
        unhomed: bool = False,
        keep_alive: float = KEEP_ALIVE,
    ) -> Jog:
        """Move in a direction until the release, or until the client is silent.

        Args:
            directions: Part of each axis in the direction; its length has no meaning.
            feed: Speed, mm/s; None for the highest from which the machine stops in time.
            unhomed: Move although the machine is not homed, so that no limit is known.
            keep_alive: Time between two signs of life, s.

        Raises:
            UsageError: As :meth:`jog_step`.
        """
        plan = partial(self._jog_move, jogging.endless_move, directions, feed, unhomed=unhomed)
        jog = Jog(plan().feed, keep_alive, self._clock)
        jog.ended = self._worker.begin("jog", lambda: self._carry_out_jog(plan, jog), control=jog)
        self._jog = jog
        jog.ended.add_done_callback(lambda _: self._forget_jog(jog))
        return jog

    def zero(
        self, values: Mapping[str, float], system: str = "G54", *, half: bool = False
    ) -> Future[dict[str, dict[str, float]]]:
        """Set the offset of a coordinate system so that the axes stand at given positions.

        Args:
            values: Work position by axis, mm; 0 makes the present place the zero.
            system: G54 to G59.3, or G92.
            half: Set half the present work position instead of ``values``.

        Returns:
            The offsets, as read back.
        """

        def zero() -> dict[str, dict[str, float]]:
            self._refuse_zero()
            wanted = dict(values)
            unknown = [letter for letter in wanted if letter not in self.machine.axes]
            if unknown or not wanted:
                hint = f"its axes are {', '.join(self.machine.axes)}"
                message = f"the machine has no axis {', '.join(unknown)}" if unknown else "no axis"
                raise UsageError(Diagnostic("jog-axis", message, hint=hint))
            if any(abs(value) > MOST_POSITION for value in wanted.values()):
                message = f"a work position is farther than {MOST_POSITION:g} mm"
                hint = "give the position of the axes in mm, or degrees"
                raise UsageError(Diagnostic("zero-value", message, hint=hint))
            view = self._worker.view
            if half:
                work = view.work_position(system)
                wanted = {letter: work[letter] / 2.0 for letter in wanted}
            if system == "G92":
                refuse_turned(system, view.rotations, "a shift would turn with it")
            elif {"x", "y"} & set(wanted) and (angle := view.rotations.get(system)):
                # Boards subtract positions by axis, so they get those of the system not turned.
                shift = view.offsets["G92"]
                work = view.work_position(system) | wanted
                place = {letter: work[letter] + shift[letter] for letter in ("x", "y")}
                place = turned(place, angle)
                wanted |= {letter: place[letter] - shift[letter] for letter in place}
            self._worker.machine.set_work_position(system, wanted)
            return self._programs.offsets_changed()

        return self._worker.begin("zero", zero)

    def select_system(self, system: str) -> None:
        """Show work positions in another coordinate system.

        Raises:
            UsageError: ``no-such-system``.
        """
        self._worker.view.select(system)

    def settings(self) -> Future[list[BoardSetting]]:
        """Return the settings of a GRBL board. UsageError ``no-settings``."""
        return self._worker.begin(
            "settings", lambda: read_settings(self._worker.machine.board, self.machine)
        )

    def change_setting(self, number: int, value: str) -> Future[None]:
        """Write a setting of a GRBL board, and read it back."""

        def change() -> None:
            change_setting(self._worker.machine.board, number, value)
            # Travel, rates and homing may be others now.
            self._worker.operated = operated(self._worker.machine.board, self.machine)
            self._programs.offsets_changed()

        return self._worker.begin("settings", change)

    # Programs

    def mdi(self, line: str, *, trust_position: bool = False) -> Future[JobEnded]:
        """Run a line, with the modal state of the lines before it.

        Args:
            line: The line.
            trust_position: The position that the board reports is right.
        """
        self.history = [*self.history, line][-MOST_HISTORY:]
        run = partial(self._programs.mdi, line, trust_position=trust_position)
        return self._worker.begin("mdi", run)

    def macro(self, name: str) -> Future[JobEnded]:
        """Run a macro. UsageError ``no-such-macro``."""
        file = self._programs.macro(name)
        return self._worker.begin("mdi", lambda: self._programs.run(file, name, RunOptions()))

    def run(
        self, program: Path, options: RunOptions | None = None, *, name: str | None = None
    ) -> Future[JobEnded]:
        """Check a program and run it.

        Args:
            program: The file.
            options: Options of the run.
            name: Name in the events; None for that of the file.
        """
        shown, chosen = name or program.name, options or RunOptions()
        return self._worker.begin("program", lambda: self._programs.run(program, shown, chosen))

    def probe(self, line: str) -> Future[JobEnded]:
        """Run the call of a probing cycle (:func:`cnc.operate.probing.mdi_line`)."""

        def probe() -> JobEnded:
            self._refuse_zero()
            self._refuse_unless_lifted(self.machine.axes)
            return self._programs.probe(line)

        return self._worker.begin("probe", probe)

    def probe_grid(self, grid: Grid, *, trust_position: bool = False) -> Future[HeightMap]:
        """Probe a surface on a grid, and return its height map.

        Args:
            grid: The points.
            trust_position: The position that the board reports is right.

        Raises:
            UsageError: ``height-map-grid``, also if a contact is missing.
        """
        grid.check()

        def probe() -> HeightMap:
            self._refuse_zero()
            self._refuse_unless_lifted(self.machine.axes)
            return self._programs.probe_grid(grid, trust_position=trust_position)

        return self._worker.begin("probe", probe)

    def probe_points(self, again: PointsAgain) -> Future[HeightMap]:
        """Probe points of a height map again, and return the map with them.

        Raises:
            UsageError: ``height-map-grid``, also if a contact is missing.
        """

        def probe() -> HeightMap:
            self._refuse_zero()
            self._refuse_unless_lifted(self.machine.axes)
            return self._programs.probe_points(again)

        return self._worker.begin("probe", probe)

    def measure(self, order: Order, moves: Moves) -> Future[Measured | None]:
        """Carry out a guided measurement, which asks questions ``reading`` and ``todo``.

        Args:
            order: What is measured, and how.
            moves: How the axes move.

        Returns:
            The result; None where the operator stopped it.

        Raises:
            UsageError: ``measure-axis``, ``measure-option``, ``machine-busy``, ``not-connected``.
        """
        measured_machine(self.machine, order)
        return self._worker.begin("measure", lambda: self._measurements.measured(order, moves))

    def measure_limits(self, letter: str, most: float) -> Future[Raised]:
        """Raise the limits of an axis until it loses steps; the future has HomingStopped at a stop.

        Args:
            letter: The axis.
            most: Factor up to which the limits of the machine file are raised.

        Raises:
            UsageError: ``measure-axis``, ``machine-busy``, ``not-connected``.
        """
        uncompensated(self.machine, [letter])
        return self._worker.begin("measure", lambda: self._measurements.raised(letter, most))

    # Requests, at any time

    def hold(self) -> None:
        """Come to rest on the path, and wait."""
        self._worker.control.hold()

    def resume(self) -> None:
        """Continue after a hold. UsageError ``machine-busy`` during a jog at a pause."""
        self._worker.resume()

    def override(
        self, *, feed: float | None = None, rapid: int | None = None, spindle: float | None = None
    ) -> None:
        """Scale feeds, traverses and spindle speeds, per cent.

        Raises:
            UsageError: ``feed-override``, ``rapid-override``, ``spindle-override``.
        """
        operated = self._worker.operated
        # All are refused before any takes effect, and before the board would refuse a later run.
        asked = Control()
        asked.take_board(overrides=operated is not None and operated.board.capabilities.overrides)
        for control in (asked, self._worker.overrides, self._worker.control):
            if feed is not None:
                control.override(feed)
            if rapid is not None:
                control.override_rapids(rapid)
            if spindle is not None:
                control.override_spindle(spindle)

    def answer(self, number: int, yes: bool, value: float | None = None) -> bool:
        """Answer a question; return whether it was open.

        Args:
            number: The question.
            yes: Whether the operator agrees.
            value: The number of a reading, mm.

        Raises:
            UsageError: ``reading-missing`` for a reading without a number.
        """
        dialog = self._worker.dialogs.answer(number, yes, value)
        if dialog is None:
            return False
        if yes and dialog.kind in ("reading", "todo"):
            self._worker.wake()
        elif dialog.kind != "restart":
            if yes:
                self._worker.resume()
            else:
                self.stop()
        return True

    def release_jog(self) -> None:
        """End the jog that waits for its release, if there is one."""
        jog = self._jog
        if jog is not None:
            jog.release()

    def keep_jog(self, number: int) -> bool:
        """Give the sign of life of a jog; return whether it moves."""
        jog = self._jog
        if jog is None or jog.id != number:
            return False
        jog.keep_alive()
        return True

    def stop(self) -> None:
        """Come to rest on the path, and end the activity."""
        self._worker.stop()

    # Parts of activities

    def _forget_jog(self, jog: Jog) -> None:
        if self._jog is jog:
            self._jog = None

    def _jog_move(
        self,
        plan: Callable[..., jogging.JogMove],
        wanted: Mapping[str, float],
        feed: float | None,
        *,
        unhomed: bool,
    ) -> jogging.JogMove:
        operated = self._worker.machine
        readings = self._worker.view.readings
        limits = operated.for_jogs()
        unknown = [letter for letter in wanted if not readings.homed.get(letter, True)]
        if unknown and not unhomed:
            names = " ".join(unknown).upper()
            hint = "home the machine, or ask for a jog without homing: no limit is known then"
            raise UsageError(Diagnostic("jog-unhomed", f"{names} is not homed", hint=hint))
        if unknown:
            axes = {
                letter: axis.model_copy(update={"travel": None}) if letter in unknown else axis
                for letter, axis in limits.axes.items()
            }
            limits = limits.model_copy(update={"axes": axes})
        move = plan(limits, readings.position, wanted, feed, operated.rest)
        assert isinstance(move, jogging.JogMove)
        return move

    def _measuring_move(self, letter: str, way: float, moves: Moves) -> None:
        """Move an axis by a distance, mm, in a measurement."""
        wanted = {letter: way}
        move = self._jog_move(jogging.step_move, wanted, moves.feed, unhomed=moves.unhomed)
        self._worker.machine.jog(move, self._worker.control, self._worker.view.take)

    def _carry_out_jog(self, plan: Callable[[], jogging.JogMove], control: Control) -> None:
        if control.held:
            return
        # From the place where the machine rests now: at a pause it may have moved until here.
        move = plan()
        self._refuse_unless_lifted(move.end)
        self._worker.machine.jog(move, control, self._worker.view.take)

    def _refuse_unless_lifted(self, letters: Iterable[str]) -> None:
        """Refuse moves across in the part, at a pause. UsageError ``jog-not-lifted``."""
        if (pause := self._worker.pause) is not None:
            pause.refuse_unless_lifted(letters, self._worker.view.readings.position.get("z"))

    def _refuse_zero(self) -> None:
        """Refuse a zero that a paused program would set back. UsageError ``pause-zero``."""
        if (pause := self._worker.pause) is not None:
            pause.refuse_zero()

    def _console(self, arrow: str, text: str) -> None:
        self.events.emit(ConsoleLine(direction="sent" if arrow == "->" else "received", text=text))

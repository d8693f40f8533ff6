"""The worker of an operator session: the only thread that uses the board.

    any thread ──► request ──────────────► Control ─────┐   hold, resume, stop, override
               └─► activity ──► queue ──► worker ──► board  connect, home, jog, zero, MDI, run
                                            │
    ticker ──► state ten times a second     └──► events

The state also comes at the beginning and the end of each activity.

While nothing runs, the worker exchanges reports with the board.
"""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import TypeVar

from cnc.boards.port import Clock, SystemClock
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, UsageError
from cnc.model.operator_control import Control, HomingStopped
from cnc.operate.events import Activity, Alarm, EventStream, Finding, Notice, State
from cnc.operate.machines import STATE_PERIOD, OperatedMachine
from cnc.operate.program_runs import Dialogs
from cnc.operate.state_view import StateView

log = logging.getLogger(__name__)

KEEP_ALIVE = 0.2
"""Time without a sign of life after which a jog ends, s."""
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


class Worker:
    """Threads, queue and requests of a session.

    Args:
        machine: The machine.
        clock: Measures the time between the signs of life of a jog; None for the real time.

    Attributes:
        events: The events.
    """

    def __init__(self, machine: Machine, clock: Clock | None = None) -> None:
        self._clock = clock or SystemClock()
        self.events = EventStream()
        self._dialogs = Dialogs(self.events)
        self._view = StateView(machine)
        self._operated: OperatedMachine | None = None
        self._control = Control()
        self._overrides = Control()
        self._jog: Jog | None = None
        self._activity: Activity = "none"
        self._busy = False
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
        return self._view.state(self._activity, self._overrides)

    def hold(self) -> None:
        """Come to rest on the path, and wait."""
        self._control.hold()

    def resume(self) -> None:
        """Continue after a hold."""
        self._control.resume()

    def override(
        self, *, feed: float | None = None, rapid: int | None = None, spindle: float | None = None
    ) -> None:
        """Scale feeds, traverses and spindle speeds, per cent.

        Raises:
            UsageError: ``feed-override``, ``rapid-override``, ``spindle-override``.
        """
        if self._operated is None or not self._operated.board.capabilities.overrides:
            for code, value in (("rapid-override", rapid), ("spindle-override", spindle)):
                if value not in (None, 100):
                    message = "this board has no such override"
                    raise UsageError(Diagnostic(code, message, hint="GRBL boards have it"))
        for control in (self._overrides, self._control):
            if feed is not None:
                control.override(feed)
            if rapid is not None:
                control.override_rapids(rapid)
            if spindle is not None:
                control.override_spindle(spindle)

    def answer(self, number: int, yes: bool) -> bool:
        """Answer a question; return whether it was open."""
        dialog = self._dialogs.answer(number, yes)
        if dialog is None:
            return False
        if dialog.kind != "restart":
            if yes:
                self._control.resume()
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
        control = self._control
        control.stop()
        control.hold()
        self._dialogs.close()

    def _forget_jog(self, jog: Jog) -> None:
        if self._jog is jog:
            self._jog = None

    def close(self) -> None:
        """Come to rest, release the board, and end the session."""
        self.stop()
        self._closed.set()
        self._tasks.put(lambda: None)
        self._worker.join()
        self._ticker.join()

    @property
    def _machine(self) -> OperatedMachine:
        if self._operated is None:
            raise not_connected()
        return self._operated

    def _begin(
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
            if needs_board and self._operated is None:
                raise not_connected()
            if self._busy:
                hint = "wait for its end, or stop it"
                message = f"the machine is busy: {self._activity}"
                raise UsageError(Diagnostic("machine-busy", message, hint=hint))
            self._busy, self._activity = True, activity
            self._control = control or self._new_control()
        self.events.emit_present(lambda: self.state)

        def work() -> None:
            try:
                result = action()
            except BaseException as error:
                self._fault(error)
                self._end_activity()
                future.set_exception(error)
            else:
                self._end_activity()
                future.set_result(result)

        self._tasks.put(work)
        return future

    def _new_control(self) -> Control:
        control = Control(self._overrides.feed_override)
        control.override_rapids(self._overrides.rapid_override)
        control.override_spindle(self._overrides.spindle_override)
        return control

    def _end_activity(self) -> None:
        machine = self._operated
        if machine is not None:
            try:
                machine.revive()
                self._view.read(machine)
            except BoardError as error:
                self._emit_fault(error)
                self._drop()
        self._dialogs.close()
        with self._lock:
            self._busy, self._activity = False, "none"
        self.events.emit_present(lambda: self.state)

    def _work(self) -> None:
        while not self._closed.is_set():
            machine = self._operated
            try:
                task = self._tasks.get(timeout=STATE_PERIOD if machine is None else machine.pause)
            except Empty:
                if machine is not None:
                    self._poll(machine)
            else:
                task()
        self._drop()

    def _poll(self, machine: OperatedMachine) -> None:
        try:
            machine.poll()
            self._view.read(machine)
        except BoardError as error:
            self._emit_fault(error)
            try:
                machine.revive()
                self._view.read(machine)
            except BoardError:
                if error.diagnostic.code != "board-alarm":
                    self._drop()

    def _tick(self) -> None:
        due = time.monotonic()
        while not self._closed.wait(max(due - time.monotonic(), 0.0)):
            due = max(due + STATE_PERIOD, time.monotonic())
            self.events.emit_present(lambda: self.state)

    def _drop(self) -> None:
        machine, self._operated = self._operated, None
        self._view.disconnected()
        if machine is not None:
            machine.board.close()

    def _fault(self, error: BaseException) -> None:
        if isinstance(error, HomingStopped):
            self._notice(Diagnostic("homing-stopped", str(error), severity="warning"))
        elif isinstance(error, CncError):
            self._emit_fault(error)
        else:
            log.critical("internal error", exc_info=error)
            message = f"cncrun failed: {type(error).__name__}: {error}"
            self._notice(Diagnostic("internal-error", message))

    def _emit_fault(self, error: CncError) -> None:
        log.error("%s", error.diagnostic.render())
        self.events.emit(Alarm(finding=Finding.of(error.diagnostic)))

    def _notice(self, found: Diagnostic) -> None:
        self.events.emit(Notice(finding=Finding.of(found)))


def not_connected() -> UsageError:
    """Return the fault of an activity without a board."""
    hint = "connect the board first"
    return UsageError(Diagnostic("not-connected", "no board is connected", hint=hint))

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

from cnc.boards.port import Clock
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
    """The thread that uses the board, its queue of activities, and the state of the session.

    Args:
        machine: The machine.

    Attributes:
        events: The events.
        dialogs: The open question to the operator.
        view: The state that is shown.
        operated: The machine behind the board; None without a board.
        control: Requests of the operator to the present activity.
        overrides: Overrides that the next activity begins with.
    """

    def __init__(self, machine: Machine) -> None:
        self.events = EventStream()
        self.dialogs = Dialogs(self.events)
        self.view = StateView(machine)
        self.operated: OperatedMachine | None = None
        self.control = Control()
        self.overrides = Control()
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
        return self.view.state(self._activity, self.overrides)

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
            if self._busy:
                hint = "wait for its end, or stop it"
                message = f"the machine is busy: {self._activity}"
                raise UsageError(Diagnostic("machine-busy", message, hint=hint))
            self._busy, self._activity = True, activity
            self.control = control or self._new_control()
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
        control = Control(self.overrides.feed_override)
        control.override_rapids(self.overrides.rapid_override)
        control.override_spindle(self.overrides.spindle_override)
        return control

    def _end_activity(self) -> None:
        machine = self.operated
        if machine is not None:
            try:
                machine.revive()
                self.view.read(machine)
            except BoardError as error:
                self._emit_fault(error)
                self.drop()
        self.dialogs.close()
        with self._lock:
            self._busy, self._activity = False, "none"
        self.events.emit_present(lambda: self.state)

    def _work(self) -> None:
        while not self._closed.is_set():
            machine = self.operated
            try:
                task = self._tasks.get(timeout=STATE_PERIOD if machine is None else machine.pause)
            except Empty:
                if machine is not None:
                    self._poll(machine)
            else:
                task()
        self.drop()

    def _poll(self, machine: OperatedMachine) -> None:
        try:
            machine.poll()
            self.view.read(machine)
        except BoardError as error:
            self._emit_fault(error)
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
            self._emit_fault(error)
        else:
            log.critical("internal error", exc_info=error)
            message = f"cncrun failed: {type(error).__name__}: {error}"
            self.notice(Diagnostic("internal-error", message))

    def _emit_fault(self, error: CncError) -> None:
        log.error("%s", error.diagnostic.render())
        self.events.emit(Alarm(finding=Finding.of(error.diagnostic)))

    def notice(self, found: Diagnostic) -> None:
        """Report a finding."""
        self.events.emit(Notice(finding=Finding.of(found)))


def not_connected() -> UsageError:
    """Return the fault of an activity without a board."""
    hint = "connect the board first"
    return UsageError(Diagnostic("not-connected", "no board is connected", hint=hint))

"""The state of the server: session, control, clients, library, checks, and records of runs."""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import secrets
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from cnc.machine.height_map import HeightMap, save_height_map
from cnc.machine.load import with_stock
from cnc.model.diagnostics import CncError, Diagnostic, UsageError
from cnc.operate.events import ConsoleLine, Event, Finding, JobEnded, Notice, as_object
from cnc.operate.height_mapping import Grid, PointsAgain
from cnc.operate.operator_session import OperatorSession
from cnc.operate.program_runs import failed
from cnc.operate.remote_session import SessionAccess
from cnc.operate.state_view import refuse_turned, work_zero
from cnc.server.checking import (
    Checker,
    CheckOrder,
    CutOrder,
    RepairOrder,
    check_job,
    cut_job,
    job_changed,
    parameters_of,
    prepare,
    repair_job,
    sketch_job,
    typed_findings,
)
from cnc.server.library import OWN, Library, Run, TextLines, Version, checked, version_of
from cnc.server.measuring import LastMeasurement
from cnc.server.project import settings_of
from cnc.session.options import RunOptions
from cnc.session.repairs import Place

T = TypeVar("T")

# Control of the machine: one client has it, the others watch.

KEY_BYTES = 16


class ControlOfMachine:
    """The client that has control.

    Args:
        on_change: Called with the name of the new holder, None for none.

    Attributes:
        holder: Its name; None for nobody.
    """

    def __init__(self, on_change: Callable[[str | None], None]) -> None:
        self.holder: str | None = None
        self._key: str | None = None
        self._on_change = on_change

    def take(self, client: str) -> str:
        """Give control to a client; return its key. The key before is void."""
        self.holder, self._key = client, secrets.token_urlsafe(KEY_BYTES)
        self._on_change(client)
        return self._key

    def release(self) -> None:
        """Give control up."""
        self.holder = self._key = None
        self._on_change(None)

    def has(self, key: str | None) -> bool:
        """Return whether a key is that of the client that has control."""
        return (
            key is not None
            and self._key is not None
            and hmac.compare_digest(key.encode(), self._key.encode())
        )


# Distribution of events to the clients, in batches, without a wait for a slow one.
#
#    machine threads ──► pending ──► every 20 ms one batch, encoded once ──► a queue for each client
#
# A client whose queue is full reads too slowly: it is disconnected. The queues are bounded, so that
# clients cost a bounded amount of memory.

BATCH_PERIOD = 0.02
"""Time in which events are gathered, s."""
MOST_PENDING = 5000
"""Events that wait for the next batch; of more, the oldest console lines are lost."""
MOST_BATCHES = 64
"""Batches that wait for a client."""
MOST_CLIENTS = 64
"""Connections for events."""
MOST_OF_ADDRESS = 16
"""Connections for events of one address."""
DIGITS = 4
"""Decimals of the positions."""


class Client:
    """The queue of one client.

    Attributes:
        number: Number of the connection.
        address: Where it comes from.
        lost: Whether the client read too slowly.
        dropped: Set when it is lost.
    """

    def __init__(self, number: int, address: str) -> None:
        self.number, self.address, self.lost = number, address, False
        self.dropped = asyncio.Event()
        self._queue: asyncio.Queue[str] = asyncio.Queue(MOST_BATCHES)

    def put(self, batch: str) -> None:
        """Add a batch; a full queue ends the connection."""
        if self.lost:
            return
        try:
            self._queue.put_nowait(batch)
        except asyncio.QueueFull:
            self.drop()

    def drop(self) -> None:
        """End the connection, even while it waits for its client."""
        self.lost = True
        self.dropped.set()

    async def next(self) -> str:
        """Return the next batch."""
        return await self._queue.get()


class Hub:
    """Takes events from any thread, and hands them to the clients in the event loop."""

    def __init__(self) -> None:
        self._pending: deque[dict[str, Any]] = deque(maxlen=MOST_PENDING)
        self._lock = threading.Lock()
        self._clients: dict[int, Client] = {}
        self._numbers = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._scheduled = False

    def start(self) -> None:
        """Use the running event loop from here on."""
        self._loop = asyncio.get_running_loop()

    def stop(self) -> None:
        """End all clients."""
        self._loop = None
        for client in self._clients.values():
            client.drop()

    def publish(self, event: Event) -> None:
        """Take an event of the session, from any thread."""
        self.publish_object(as_object(event))

    def publish_object(self, event: dict[str, Any]) -> None:
        """Take an event in its JSON form, from any thread."""
        loop = self._loop
        if loop is None or not self._clients:
            return
        with self._lock:
            self._pending.append(event)
            scheduled, self._scheduled = self._scheduled, True
        if not scheduled:
            with contextlib.suppress(RuntimeError):  # The loop may be closed by now.
                loop.call_soon_threadsafe(loop.call_later, BATCH_PERIOD, self._send)

    def join(self, address: str) -> Client | None:
        """Return a new client; None if there are too many, or too many of its address."""
        of_address = sum(member.address == address for member in self._clients.values())
        if len(self._clients) >= MOST_CLIENTS or of_address >= MOST_OF_ADDRESS:
            return None
        self._numbers += 1
        client = Client(self._numbers, address)
        self._clients[client.number] = client
        return client

    def leave(self, client: Client) -> None:
        """Forget a client."""
        self._clients.pop(client.number, None)

    def _send(self) -> None:
        with self._lock:
            events = list(self._pending)
            self._pending.clear()
            self._scheduled = False
        batch = encoded(events)
        for client in list(self._clients.values()):
            client.put(batch)


def encoded(events: list[dict[str, Any]]) -> str:
    """Return events as JSON, with rounded numbers."""
    return json.dumps(_rounded(events), allow_nan=False, separators=(",", ":"))


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DIGITS) if abs(value) < 1e15 else None
    if isinstance(value, dict):
        return {name: _rounded(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(part) for part in value]
    return value


MOST_LOG_LINES = 50_000
"""Lines of the log of a run; of more, the first are lost."""
SKETCHED = 500_000
"""Size of a program that is drawn coarsely before its check ends, bytes."""
MOST_TEXTS = 8
"""Indexes of program texts that are kept."""


@dataclass(slots=True)
class _Run:
    """A run under way, and whether its end is in the history."""

    job: str
    began: float
    recorded: bool = False
    log: deque[str] = field(default_factory=lambda: deque(maxlen=MOST_LOG_LINES))

    def note(self, text: str) -> None:
        self.log.append(f"{time.time() - self.began:10.3f} {text}")


def _stamp(file: Path) -> tuple[int, int, int]:
    """Return what changes with each change of a file."""
    status = file.stat()
    return status.st_ino, status.st_mtime_ns, status.st_size


class _Check(NamedTuple):
    """The last check of a job and a height map, and the text that it reads."""

    text: Version
    future: Future[dict[str, Any] | None]


class Console:
    """What the requests share.

    Args:
        session: The operator session.
        library: The library.

    Attributes:
        control: The client that has control.
        hub: Distributes the events.
        measurement: The last measurement.
    """

    def __init__(self, session: SessionAccess, library: Library) -> None:
        self.session, self.library = session, library
        self.hub = Hub()
        self.control = ControlOfMachine(self._control_changed)
        self.measurement = LastMeasurement(session, self.hub.publish_object)
        self._checker: Checker | None = None
        self._checking: dict[tuple[str, str | None], _Check] = {}
        self._texts: dict[str, TextLines] = {}
        self._run: _Run | None = None
        self._asked: _Run | None = None
        self._lock = threading.Lock()
        self._history = threading.Lock()
        self._closing = False
        self._end_listening = session.listen(self._event)

    def close(self) -> None:
        """End the checks and the session."""
        self._closing = True
        self._end_listening()
        if self._checker is not None:
            self._checker.close()
        self.session.close()

    def prepare(self) -> None:
        """Start the processes of checks and coarse pictures before the first one."""
        workers = self._workers()
        workers.pool.submit(prepare)
        workers.sketches.submit(prepare)

    # Jobs

    def text(self, name: str) -> TextLines:
        """Return the lines of a job."""
        file = self.library.path(name)
        with self._lock:
            text = self._texts.get(name)
            if text is None or text.changed != file.stat().st_mtime_ns:
                text = TextLines(file)
                while len(self._texts) >= MOST_TEXTS:
                    del self._texts[next(iter(self._texts))]
                self._texts[name] = text
        return text

    def check(self, name: str, height_map: str | None = None) -> Future[dict[str, Any] | None]:
        """Begin a check, or return the one under way.

        Args:
            name: The job.
            height_map: Name of the height map that warps it; None for none.
        """
        text = version_of(self.library.path(name))
        if height_map is not None:
            self.library.height_map_file(height_map)
        with self._lock:
            running = self._checking.get((name, height_map))
            if running is not None and running.text == text and not running.future.done():
                return running.future
            order = replace(self._order(name), height_map=height_map)
            if self.library.path(name).stat().st_size >= SKETCHED:
                sketched = self._workers().sketches.submit(sketch_job, order)
                sketched.add_done_callback(lambda done: self._sketched(name, done))
            future = self._workers().pool.submit(check_job, order)
            self._checking[name, height_map] = _Check(text, future)
        future.add_done_callback(lambda done: self._checked(name, done))
        return future

    def cut(self, name: str, stock: str, resolution: float | None, system: str = "") -> None:
        """Begin to simulate the cut of a job; the event ``job-cut`` ends it.

        Raises:
            UsageError: ``no-such-job``, ``no-such-system``, ``stock-missing``, ``stock-malformed``.
        """
        file, session = self.library.path(name), self.session
        if not stock:
            stock = settings_of(file, session.limited_machine).stock
        if system and stock:
            refuse_turned(system, session.rotations, "the raw part stands along the axes")
        zero = work_zero(session.offsets, system, session.rotations) if system else {}
        machine = self.session.limited_machine
        if stock:
            with_stock(machine, stock, zero)
        elif machine.stock is None:
            message = "there is no stock to cut"
            hint = "give the raw part, such as X0:100,Y0:60,Z-12:0"
            raise UsageError(Diagnostic("stock-missing", message, hint=hint))
        with self._lock:
            order = CutOrder(self._order(name), stock, resolution, zero)
            future = self._workers().pool.submit(cut_job, order)
        future.add_done_callback(lambda done: self._cut(name, done))

    async def repair(self, name: str, place: Place) -> dict[str, Any]:
        """Return the repair of a finding, see :func:`repair_job`; the job is left as it is.

        Raises:
            UsageError: ``no-such-job``, ``no-repair``.
        """
        return await self._repair(RepairOrder(await self._order_of_repair(name), place))

    async def write_repair(
        self, name: str, place: Place, version: str, *, unsafe: bool
    ) -> dict[str, Any]:
        """Repair a finding in the file of a job, which is replaced as a whole.

        Args:
            name: The job.
            place: Code, line and column of the finding.
            version: The text that was shown.
            unsafe: Whether the repair may change what the program does.

        Raises:
            UsageError: ``no-such-job``, ``no-repair``, ``machine-busy`` while the job runs,
                ``job-changed``, ``repair-unsafe``, ``can-not-write``.
        """
        self.refuse_change(name)
        check, file = await self._order_of_repair(name), self.library.path(name)
        before = _stamp(file)
        with tempfile.TemporaryDirectory(dir=self.library.folder / OWN) as folder:
            draft = Path(folder) / "draft"
            made = await self._repair(RepairOrder(check, place, version, unsafe, draft))
            # From here on no other request has its turn.
            self.refuse_change(name)
            if _stamp(self.library.path(name)) != before:
                raise job_changed(name)
            self.library.adopt(name, draft)
        self.jobs_changed()
        return made

    async def _order_of_repair(self, name: str) -> CheckOrder:
        self.library.path(name)
        return await asyncio.to_thread(self._order, name)

    async def _repair(self, order: RepairOrder) -> dict[str, Any]:
        with self._lock:
            future = self._workers().pool.submit(repair_job, order)
        return await self._of_process(future)

    async def typed(self, name: str, text: str) -> list[dict[str, Any]]:
        """Return the findings of a text as it is typed, see :func:`typed_findings`."""
        order = await asyncio.to_thread(self._order, checked(name))
        with self._lock:
            future = self._workers().sketches.submit(typed_findings, order, text)
        return await self._of_process(future)

    async def _of_process(self, future: Future[T]) -> T:
        """Return the result of a process; the next order begins with a new one if it has died."""
        try:
            return await asyncio.wrap_future(future)
        except BrokenExecutor:
            with self._lock:
                self._checker = None
            raise

    def _workers(self) -> Checker:
        if self._checker is None:
            self._checker = Checker()
        return self._checker

    def _order(self, name: str) -> CheckOrder:
        session = self.session
        machine, parameters = (
            session.limited_machine,
            parameters_of(session.offsets, session.rotations),
        )
        return CheckOrder(name, self.library.folder, machine, parameters)

    async def run(self, name: str, options: RunOptions) -> None:
        """Begin a run. UsageError if the machine is busy, or there is no such job."""
        file = self.library.path(name)
        run = self._asked = _Run(name, time.time())
        options = settings_of(file, self.session.limited_machine, options).options
        asked = self.session.ask(OperatorSession.run, file, options, name=name)

        def begun(done: Future[Future[JobEnded]]) -> None:
            if done.exception() is None:
                self._record_begin(run)
                done.result().add_done_callback(lambda each: self._ended(run, each))
            elif self._asked is run:
                self._asked = None

        # In the thread of the events, or here: then a short run may have ended already.
        asked.add_done_callback(begun)
        await asyncio.wrap_future(asked)

    def remove(self, name: str) -> None:
        """Remove a job. UsageError ``machine-busy`` while it runs."""
        self.refuse_change(name)
        self.library.remove(name)
        self.jobs_changed()

    def refuse_change(self, name: str) -> None:
        """Refuse the change of a program that runs. UsageError ``machine-busy``."""
        run = self._run or self._asked
        if run is not None and run.job == name:
            message, hint = f"{name} runs", "wait for its end, or stop it"
            raise UsageError(Diagnostic("machine-busy", message, hint=hint))

    def _sketched(self, name: str, done: Future[bool]) -> None:
        if self._closing or done.cancelled():
            return
        if isinstance(done.exception(), BrokenExecutor):
            # The next picture begins with a new process.
            with self._lock:
                self._checker = None
        elif not done.exception() and done.result():
            self.hub.publish_object({"event": "job-sketched", "time": time.time(), "name": name})

    def _checked(self, name: str, done: Future[dict[str, Any] | None]) -> None:
        if self._closing or done.cancelled():
            return
        error = done.exception()
        if isinstance(error, BrokenExecutor):
            # The next check begins with a new process.
            with self._lock:
                self._checker = None
        found = {} if error else done.result()
        if found is None:
            return  # The text was changed meanwhile, and its own check follows.
        summary: dict[str, Any] = found
        if error is not None:
            message = error.diagnostic.message if isinstance(error, CncError) else str(error)
            finding = Finding(code="check-failed", message=f"{name} was not checked: {message}")
            self.hub.publish(Notice(finding=finding))
        severities = [
            finding_of_check["severity"] for finding_of_check in summary.get("errors", ())
        ]
        self.hub.publish_object(
            {
                "event": "job-checked",
                "time": time.time(),
                "name": name,
                "ok": bool(summary) and "error" not in severities,
                "errors": severities.count("error"),
                "warnings": severities.count("warning"),
            }
        )

    def _cut(self, name: str, done: Future[dict[str, Any]]) -> None:
        error = None if done.cancelled() else done.exception()
        is_cut = not done.cancelled() and error is None and done.result()["ok"]
        if error is not None:
            message = error.diagnostic.message if isinstance(error, CncError) else str(error)
            finding = Finding(code="cut-failed", message=f"{name} was not cut: {message}")
            self.hub.publish(Notice(finding=finding))
        findings = [] if done.cancelled() or error else done.result()["findings"]
        event = {"event": "job-cut", "time": time.time(), "name": name, "ok": is_cut}
        self.hub.publish_object(event | {"findings": findings})

    def _ended(self, run: _Run, done: Future[JobEnded]) -> None:
        error = done.exception()
        if error is None:
            ended = done.result()
        elif isinstance(error, CncError):
            ended = failed(error, run.job)
        else:
            ended = JobEnded(program=run.job, outcome="failed")
        self._record(run, ended)

    def _record_begin(self, run: _Run) -> None:
        """Write the begin of a run to the history, if its end is not there yet."""
        with self._history:
            if run.recorded:
                return
            self._run = run
            # A server that is killed during the run leaves this record of it.
            with suppress(OSError, UsageError):
                self.library.add_run(Run(job=run.job, began=run.began), "")

    def _record(self, run: _Run, ended: JobEnded) -> None:
        """Write the end of a run to the history."""
        with self._history:
            if run.recorded:
                return
            run.recorded = True
            self._run = self._asked = None
        for finding in ended.findings:
            run.note(f"{finding.severity}: {finding.code}: {finding.message}")
        run.note(f"end: {ended.outcome}")
        record = Run(
            job=run.job,
            began=run.began,
            seconds=time.time() - run.began,
            machine_seconds=ended.seconds,
            outcome=ended.outcome,
            line=ended.stopped_at_line,
            resume_line=ended.resume_line,
            findings=[finding for finding in ended.findings if finding.severity == "error"],
        )
        self.library.add_run(record, "\n".join(run.log) + "\n")
        self.jobs_changed()

    # Height maps

    async def probe_grid(self, name: str, grid: Grid, system: str) -> Future[HeightMap]:
        """Begin to probe a grid; the event ``height-map`` ends it.

        Raises:
            UsageError: ``height-map-name``, ``height-map-grid``, ``no-such-system``,
                ``machine-busy``, ``not-connected``.
        """
        file = self.library.new_height_map(name)
        grid.check()
        session = self.session
        await asyncio.wrap_future(session.ask(OperatorSession.select_system, system))
        future = await asyncio.wrap_future(session.ask(OperatorSession.probe_grid, grid))
        return self._keep_map(name, file, future)

    async def probe_points(self, name: str, again: PointsAgain) -> Future[HeightMap]:
        """Begin to probe points of a height map again; the event ``height-map`` ends it."""
        asked = self.session.ask(OperatorSession.probe_points, again)
        file = self.library.height_map_file(name)
        return self._keep_map(name, file, await asyncio.wrap_future(asked))

    def _keep_map(self, name: str, file: Path, future: Future[HeightMap]) -> Future[HeightMap]:
        """Write a height map when it is probed."""

        def probed(done: Future[HeightMap]) -> None:
            if not done.cancelled() and done.exception() is None:
                save_height_map(done.result(), file)
                self.height_maps_changed(name)

        future.add_done_callback(probed)
        return future

    def height_maps_changed(self, name: str) -> None:
        """Tell the clients that a height map has changed."""
        self.hub.publish_object({"event": "height-map", "time": time.time(), "name": name})

    # Events

    def jobs_changed(self) -> None:
        """Tell the clients that the library has changed."""
        self.hub.publish_object({"event": "jobs", "time": time.time()})

    def macros_changed(self) -> None:
        """Tell the clients that a macro has changed."""
        self.hub.publish_object({"event": "macros", "time": time.time()})

    def _control_changed(self, holder: str | None) -> None:
        self.session.ask(OperatorSession.release_jog)
        self.hub.publish_object({"event": "control", "time": time.time(), "holder": holder})

    def _event(self, event: Event) -> None:
        run = self._run or self._asked
        if run is not None:
            if isinstance(event, ConsoleLine):
                run.note(f"{'->' if event.direction == 'sent' else '<-'} {event.text}")
            elif event.event in ("dialog", "dialog-closed", "alarm", "notice"):
                finding = getattr(event, "finding", None)
                run.note(event.event if finding is None else f"{event.event}: {finding.message}")
        if run is not None and isinstance(event, JobEnded) and event.program == run.job:
            # Before any client learns of the end: it may ask for the history at once.
            self._record(run, event)
        self.hub.publish(event)

"""The requests: the machine, the jobs with their uploads, and the height maps."""

from __future__ import annotations

import asyncio
import codecs
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar

from fastapi import APIRouter, Depends, Header, HTTPException, Query, Request
from fastapi.responses import FileResponse, JSONResponse
from pydantic import FiniteFloat

from cnc.boards.registry import board_names
from cnc.checks.translations import LANGUAGES, findings_in
from cnc.measure.orders import Backlash, Order, Pitch, Ringing, Square, TouchProbe
from cnc.model import parameter_numbers as numbers
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.units import per_minute, per_second
from cnc.operate.events import as_object
from cnc.operate.height_mapping import Grid, PointsAgain
from cnc.operate.measuring import Moves
from cnc.operate.operator_session import OperatorSession, begin_jog
from cnc.operate.probing import cycles, mdi_line
from cnc.server.checking import job_changed
from cnc.server.console import Console
from cnc.server.library import OWN, Library, checked
from cnc.server.measuring import Kind
from cnc.server.models import (
    Accepted,
    CheckJob,
    ChooseSystem,
    Connect,
    ControlKey,
    CutJob,
    CycleRun,
    DialogAnswer,
    EnteredLine,
    Home,
    JogKeep,
    JogStart,
    JogStarted,
    JogStep,
    LogText,
    MeasureBacklash,
    MeasureLimits,
    MeasurePitch,
    MeasureRinging,
    MeasureSquare,
    OfMeasurement,
    Override,
    ProbeAgain,
    ProbeGrid,
    Repair,
    RepairJob,
    RunJob,
    Setting,
    SettingValue,
    TakeControl,
    TextPart,
    WriteMeasured,
    Zero,
)
from cnc.session.options import RunOptions
from cnc.version import __version__
from cnc.view.collect import stock_box

KEPT = 3600
"""Time for which a browser keeps the meanings of the findings, s."""
P = ParamSpec("P")
T = TypeVar("T")
QUICK = 0.05
"""Time in which a command that is refused at once is refused, s."""


async def console_of(request: Request) -> Console:
    """Return the console of the application."""
    console = request.app.state.console
    assert isinstance(console, Console)
    return console


async def controlled(
    request: Request, x_control: Annotated[str | None, Header(max_length=100)] = None
) -> Console:
    """Return the console to the client that has control; 409 ``no-control`` to others."""
    console = await console_of(request)
    if not console.control.has(x_control):
        who = console.control.holder
        message = "no client has control" if who is None else f"{who} has control"
        hint = "take control first: POST /api/control"
        raise HTTPException(409, {"code": "no-control", "message": message, "hint": hint})
    return console


Shared = Annotated[Console, Depends(console_of)]
Controlled = Annotated[Console, Depends(controlled)]
router = APIRouter(prefix="/api")


async def ask(
    console: Console,
    method: Callable[Concatenate[OperatorSession, P], T],
    *args: P.args,
    **kwargs: P.kwargs,
) -> T:
    """Call a method of the session; return what it returns."""
    return await asyncio.wrap_future(console.session.ask(method, *args, **kwargs))


async def result(
    console: Console,
    activity: Callable[Concatenate[OperatorSession, P], Future[T]],
    *args: P.args,
    **kwargs: P.kwargs,
) -> T:
    """Carry out a short activity of the session; return its result."""
    return await asyncio.wrap_future(await ask(console, activity, *args, **kwargs))


async def accepted(future: Future[Any]) -> Accepted:
    """Return after the acceptance of a long activity; raise the fault of one that fails at once."""
    wrapped = asyncio.wrap_future(future)
    done, _ = await asyncio.wait([wrapped], timeout=QUICK)
    if done:
        wrapped.result()
    else:
        wrapped.add_done_callback(lambda each: each.cancelled() or each.exception())
    return Accepted()


@router.get("/machine")
async def machine(console: Shared) -> dict[str, Any]:
    """Return the machine: axes, travel, boards, systems."""
    session = console.session
    known = session.limited_machine
    return {
        "name": known.name,
        "kind": known.kind,
        "axes": {
            letter: {"travel": axis.travel, "max_velocity": per_minute(axis.max_velocity)}
            for letter, axis in known.axes.items()
        },
        "board": session.machine.board.kind,
        "boards": [name for name in board_names() if name != "file"],
        "systems": list(numbers.SYSTEMS),
        "version": __version__,
        "stock": stock_box(known),
        "homes": known.can_home or bool(session.state.homed),
    }


@router.get("/meanings/{language}")
def meanings(language: str) -> JSONResponse:
    """Return meaning and remedy of each finding by its code, in a language other than English."""
    if language not in LANGUAGES:
        raise _not_found(f"there are no texts in the language {language[:20]!r}")
    texts = {
        code: {"meaning": finding.meaning, "remedy": finding.remedy}
        for code, finding in findings_in(language).items()
    }
    return JSONResponse(texts, headers={"cache-control": f"private, max-age={KEPT}"})


@router.get("/state")
async def state(console: Shared) -> dict[str, Any]:
    """Return the present state, as the event of this name."""
    return as_object(console.session.state)


@router.post("/control")
async def take_control(body: TakeControl, console: Shared) -> ControlKey:
    """Take control from the client that has it."""
    return ControlKey(key=console.control.take(body.client), holder=body.client)


@router.delete("/control")
async def release_control(console: Controlled) -> Accepted:
    """Give control up."""
    console.control.release()
    return Accepted()


@router.post("/connect")
async def connect(body: Connect, console: Controlled) -> Accepted:
    """Connect a board, and wait until it answers."""
    await result(console, OperatorSession.connect, body.board, body.port)
    return Accepted()


@router.post("/disconnect")
async def disconnect(console: Controlled) -> Accepted:
    """Release the board."""
    await result(console, OperatorSession.disconnect)
    return Accepted()


@router.post("/home")
async def home(body: Home, console: Controlled) -> Accepted:
    """Home axes."""
    return await accepted(await ask(console, OperatorSession.home, body.axes))


@router.post("/unlock")
async def unlock(console: Controlled) -> Accepted:
    """Leave an alarm without homing."""
    return await accepted(await ask(console, OperatorSession.unlock))


@router.post("/jog/step")
async def jog_step(body: JogStep, console: Controlled) -> Accepted:
    """Move by a distance."""
    feed = None if body.feed is None else per_second(body.feed)
    return await accepted(
        await ask(console, OperatorSession.jog_step, body.distances, feed, unhomed=body.unhomed)
    )


@router.post("/jog/start")
async def jog_start(body: JogStart, console: Controlled) -> JogStarted:
    """Move until the release, or until the signs of life end."""
    feed = None if body.feed is None else per_second(body.feed)
    jog = await ask(console, begin_jog, body.directions, feed, unhomed=body.unhomed)
    return JogStarted(jog=jog.id, feed=per_minute(jog.feed))


@router.post("/jog/keep")
async def jog_keep(body: JogKeep, console: Controlled) -> Accepted:
    """Give a sign of life."""
    return Accepted(accepted=await ask(console, OperatorSession.keep_jog, body.jog))


@router.post("/jog/stop")
async def jog_stop(console: Shared) -> Accepted:
    """Release the jog; every client may."""
    await ask(console, OperatorSession.release_jog)
    return Accepted()


@router.post("/zero")
async def zero(body: Zero, console: Controlled) -> dict[str, dict[str, float]]:
    """Set offsets; return them as read back."""
    return await result(console, OperatorSession.zero, body.axes, body.system, half=body.half)


@router.get("/offsets")
async def offsets(console: Shared) -> dict[str, dict[str, float]]:
    """Return the offsets by name and axis, mm."""
    return console.session.offsets


@router.post("/system")
async def choose_system(body: ChooseSystem, console: Controlled) -> Accepted:
    """Show the work position in another coordinate system."""
    await ask(console, OperatorSession.select_system, body.system)
    return Accepted()


@router.get("/mdi")
async def entered_lines(console: Shared) -> list[str]:
    """Return the lines that were entered."""
    return console.session.history


@router.post("/mdi")
async def mdi(body: EnteredLine, console: Controlled) -> Accepted:
    """Run a line."""
    return await accepted(await ask(console, OperatorSession.mdi, body.line))


@router.post("/macros/{name}/run")
async def macro(name: str, console: Controlled) -> Accepted:
    """Run a macro."""
    return await accepted(await ask(console, OperatorSession.macro, name))


@router.get("/probing")
def probing(console: Shared) -> list[dict[str, Any]]:
    """Return the probing cycles and their parameters."""
    return [asdict(cycle) for cycle in cycles(console.session.machine)]


@router.post("/probing/{name}/run")
async def probe(name: str, body: CycleRun, console: Controlled) -> Accepted:
    """Run a probing cycle."""
    line = mdi_line(name, body.parameters, console.session.machine)
    return await accepted(await ask(console, OperatorSession.probe, line))


@router.post("/hold")
async def hold(console: Controlled) -> Accepted:
    """Come to rest on the path, and wait."""
    await ask(console, OperatorSession.hold)
    return Accepted()


@router.post("/resume")
async def resume(console: Controlled) -> Accepted:
    """Continue after a hold."""
    await ask(console, OperatorSession.resume)
    return Accepted()


@router.post("/stop")
async def stop(console: Shared) -> Accepted:
    """Come to rest, and end the activity; every client may."""
    asked = console.session.ask(OperatorSession.stop)
    # Without a board nothing moves, and the process of the session may be starting still.
    if console.session.state.board:
        await asyncio.wrap_future(asked)
    return Accepted()


@router.post("/override")
async def override(body: Override, console: Controlled) -> Accepted:
    """Scale feeds, traverses and spindle speeds."""
    await ask(
        console, OperatorSession.override, feed=body.feed, rapid=body.rapid, spindle=body.spindle
    )
    return Accepted()


@router.post("/answer")
async def answer(body: DialogAnswer, console: Controlled) -> Accepted:
    """Answer a dialog."""
    answered = await ask(console, OperatorSession.answer, body.dialog, body.yes, body.value)
    return Accepted(accepted=answered)


@router.get("/settings")
async def settings(console: Shared) -> list[Setting]:
    """Return the settings of a GRBL board."""
    return [Setting(**asdict(each)) for each in await result(console, OperatorSession.settings)]


@router.put("/settings/{number}")
async def change_setting(number: int, body: SettingValue, console: Controlled) -> Accepted:
    """Write a setting, and read it back."""
    await result(console, OperatorSession.change_setting, number, body.value)
    return Accepted()


# Decoding of an upload ``{"text": "..."}`` in pieces, so that no long step stops the machine.
#
# The JSON parser of Python holds the interpreter for the whole body, a second for a large program.
# Here each piece is a short text of its own.

PIECE = 1 << 16
"""Characters that are decoded at a time."""
_HEAD = re.compile(r'\s*\{\s*"text"\s*:\s*"')
_HEAD_PART = re.compile(r'\s*(?:\{\s*(?:"(?:t(?:e(?:x(?:t(?:"\s*(?::\s*"?)?)?)?)?)?)?)?)?')
_HIGH, _LOW, _FOUR = "[dD][89abAB][0-9a-fA-F]{2}", "[dD][c-fC-F][0-9a-fA-F]{2}", "[0-9a-fA-F]{4}"
_PLAIN = re.compile(
    r'(?:[^"\\\x00-\x1f]|\\["\\/bfnrt]'
    rf"|\\u(?!{_HIGH}){_FOUR}|\\u{_HIGH}\\u{_LOW}"
    # Half a character, where the next bytes cannot be the other half.
    rf"|\\u{_HIGH}(?=[^\\]|\\[^u]|\\u(?!{_LOW}){_FOUR}))*"
)
_TAIL = re.compile(r'"\s*\}\s*')
LONGEST_ESCAPE = 12
"""Characters of two escapes, which may be one character together."""


class UploadDecoder:
    """Decodes the body of an upload.

    Attributes:
        done: Whether the text is complete.
    """

    def __init__(self) -> None:
        self.done = False
        self._decoder = codecs.getincrementaldecoder("utf-8")()
        self._rest = ""
        self._inside = False

    def feed(self, data: bytes, *, last: bool = False) -> Iterator[str]:
        """Yield the parts of the text in the next bytes of the body.

        Raises:
            UsageError: ``upload-format``.
        """
        try:
            self._rest += self._decoder.decode(data, last)
        except UnicodeDecodeError:
            raise _wrong("its bytes are not UTF-8") from None
        if not self._inside and not self._begins():
            if last:
                raise _wrong("it has no text")
            return
        while self._rest and not self.done:
            piece, self._rest = self._rest[:PIECE], self._rest[PIECE:]
            plain = _PLAIN.match(piece)
            assert plain is not None
            end = plain.end()
            stays = piece[end:] + self._rest
            if end:
                yield json.loads(f'"{piece[:end]}"')
            self._rest = stays
            if not end or stays.startswith('"'):
                break
        self._finish(last=last)

    def _begins(self) -> bool:
        head = _HEAD.match(self._rest)
        if head is None:
            if not _HEAD_PART.fullmatch(self._rest):
                raise _wrong("it is not an object with the key text alone")
            return False
        self._rest, self._inside = self._rest[head.end() :], True
        return True

    def _finish(self, *, last: bool) -> None:
        rest = self._rest
        if rest.startswith('"'):
            if _TAIL.fullmatch(rest):
                self._rest, self.done = "", True
            elif last or not re.fullmatch(r'"\s*', rest):
                raise _wrong("something follows its text")
        elif len(rest) >= LONGEST_ESCAPE and not _PLAIN.match(rest[: LONGEST_ESCAPE + 1]):
            raise _wrong("its text has a wrong escape")
        elif rest and rest[0] < " ":
            raise _wrong("its text has a control character that is not escaped")
        if last and not self.done:
            raise _wrong("it ends within its text")


def _wrong(reason: str) -> UsageError:
    hint = 'send {"text": "..."} as JSON'
    return UsageError(
        Diagnostic("upload-format", f"the upload cannot be read: {reason}", hint=hint)
    )


# The requests about jobs: upload, text, check, toolpath, run, history, log.

MOST_LINES = 5000
"""Lines of a text in one answer."""
HISTORY_OF_JOB = 20


def _job(library: Library, name: str, last_run: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a job with the outcome of its last run."""
    status = library.path(name).stat()
    return {
        "name": name,
        "size": status.st_size,
        "changed": status.st_mtime,
        "outcome": None if last_run is None else last_run["outcome"],
    }


def _not_found(what: str) -> HTTPException:
    return HTTPException(404, {"code": "no-such-result", "message": what, "hint": ""})


@router.get("/jobs")
def jobs(console: Shared) -> list[dict[str, Any]]:
    """Return the jobs of the library."""
    library = console.library
    last_runs = {run["job"]: run for run in reversed(library.history())}
    return [_job(library, name, last_runs.get(name)) for name in library.names()]


@router.get("/left-out")
def left_out(console: Shared) -> list[dict[str, str]]:
    """Return the files of the library that are no jobs, and why."""
    return console.library.left_out()


@router.put(
    "/jobs/{name}",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {
                    "schema": {
                        "type": "object",
                        "properties": {"text": {"type": "string"}},
                        "required": ["text"],
                    }
                }
            },
        }
    },
)
async def upload(
    name: str, request: Request, console: Shared, changed: FiniteFloat | None = None
) -> dict[str, Any]:
    """Write a program into the library: the body is ``{"text": "..."}``.

    With ``changed`` only the text of this time is replaced; 409 ``job-changed`` for another.
    """
    library = console.library

    def refuse() -> None:
        console.refuse_change(checked(name))
        if changed is not None and library.path(name).stat().st_mtime != changed:
            raise job_changed(name)

    refuse()
    decoder = UploadDecoder()
    handle, draft = tempfile.mkstemp(dir=library.folder / OWN)
    try:
        with open(handle, "w", encoding="utf-8", errors="replace", newline="") as target:
            async for piece in request.stream():
                for text in decoder.feed(piece, last=not piece):
                    target.write(text)
                    # Other requests, and the machine, have their turn between two pieces.
                    await asyncio.sleep(0)
        refuse()
        library.adopt(name, Path(draft))
    finally:
        Path(draft).unlink(missing_ok=True)
    console.jobs_changed()
    return _job(library, name, next(iter(library.history(1, name)), None))


@router.get("/jobs/{name}")
async def job(name: str, console: Shared) -> dict[str, Any]:
    """Return a job with its last check and its last runs."""
    library = console.library
    history = library.history(HISTORY_OF_JOB, name)
    lines = await asyncio.to_thread(console.text, name)
    return _job(library, name, next(iter(history), None)) | {
        "lines": lines.total,
        "check": library.summary(name),
        "history": history,
    }


@router.delete("/jobs/{name}")
def remove(name: str, console: Controlled) -> Accepted:
    """Remove a job."""
    console.remove(name)
    return Accepted()


@router.get("/jobs/{name}/text")
async def text(
    name: str,
    console: Shared,
    first: int = Query(default=1, ge=1),
    count: int = Query(default=1000, ge=1, le=MOST_LINES),
) -> TextPart:
    """Return lines of a program."""
    lines = await asyncio.to_thread(console.text, name)
    found = await asyncio.to_thread(lines.lines, first, count)
    return TextPart(first=first, lines=found, total=lines.total)


@router.post("/jobs/{name}/check")
def check(name: str, console: Shared, body: CheckJob | None = None) -> Accepted:
    """Begin a check."""
    console.check(name, None if body is None else body.height_map)
    return Accepted()


@router.get("/jobs/{name}/check")
def summary(name: str, console: Shared) -> dict[str, Any]:
    """Return the summary of the last check."""
    kept = console.library.summary(name)
    if kept is None:
        raise _not_found(f"{name} has not been checked since its last change")
    return kept


@router.get("/jobs/{name}/repair")
async def repair(
    name: str,
    console: Shared,
    code: Annotated[str, Query(max_length=80)],
    line: Annotated[int, Query(ge=0)],
    column: Annotated[int, Query(ge=0)],
) -> Repair:
    """Show the repair of a finding: what it does, and each line before and after it."""
    return Repair(**await console.repair(name, (code, line, column)))


@router.post("/jobs/{name}/repair")
async def write_repair(name: str, body: RepairJob, console: Controlled) -> Repair:
    """Repair a finding in the file of the job, if its text is still the one that was shown."""
    place = (body.code, body.line, body.column)
    made = await console.write_repair(name, place, body.version, unsafe=body.unsafe)
    return Repair(**made)


@router.get("/jobs/{name}/toolpath")
def toolpath(name: str, console: Shared) -> FileResponse:
    """Return the toolpath of the last check."""
    library = console.library
    library.path(name)
    file = library.own(name, "path.json")
    if library.summary(name) is None or not file.is_file():
        raise _not_found(f"{name} has no toolpath: check it first")
    return FileResponse(file, media_type="application/json", stat_result=os.stat(file))


@router.get("/jobs/{name}/sketch")
def sketch(name: str, console: Shared) -> FileResponse:
    """Return a coarse picture of a long job, in the form of its toolpath."""
    console.library.path(name)
    file = console.library.own(name, "sketch.json")
    if not file.is_file():
        raise _not_found(f"{name} has no coarse picture: it is short, or not checked yet")
    return FileResponse(file, media_type="application/json", stat_result=os.stat(file))


@router.post("/jobs/{name}/cut")
def cut(name: str, body: CutJob, console: Shared) -> Accepted:
    """Begin to simulate the cut; its end is the event ``job-cut``."""
    console.cut(name, body.stock, body.resolution, body.system)
    return Accepted()


@router.get("/jobs/{name}/part")
def part(name: str, console: Shared) -> FileResponse:
    """Return the surface of the part that the last simulated cut left."""
    return _result(console.library, name, "part.json", "application/json")


@router.get("/jobs/{name}/stl")
def stl(name: str, console: Shared) -> FileResponse:
    """Return the part as an STL file."""
    return _result(console.library, name, "stl", "model/stl")


def _result(library: Library, name: str, kind: str, media_type: str) -> FileResponse:
    library.path(name)
    file = library.own(name, kind)
    if not file.is_file():
        raise _not_found(f"{name} has not been cut since its last change: POST .../cut first")
    return FileResponse(file, media_type=media_type, stat_result=os.stat(file))


@router.post("/jobs/{name}/run")
async def run(name: str, body: RunJob, console: Controlled) -> Accepted:
    """Check a job on the board, and run it."""
    height_map = body.height_map
    options = RunOptions(
        from_line=body.from_line,
        home=body.home,
        trust_position=body.trust_position,
        optional_stop=body.optional_stop,
        height_map=None if height_map is None else str(console.library.height_map_file(height_map)),
    )
    await console.run(name, options)
    return Accepted()


@router.get("/jobs/{name}/log")
def log(name: str, console: Shared, began: FiniteFloat | None = None) -> LogText:
    """Return the log of the run that began at a time, s since 1970; else of the last one."""
    return LogText(text=console.library.log(name, began))


@router.get("/unfinished")
def unfinished(console: Shared) -> dict[str, Any] | None:
    """Return the latest run if the server was killed during it; else null."""
    return console.library.unfinished()


@router.get("/history")
def history(console: Shared) -> list[dict[str, Any]]:
    """Return the runs, the latest first."""
    return console.library.history()


# The requests about height maps: list, read, probe, remove.


@router.get("/height-maps")
def height_maps(console: Shared) -> list[str]:
    """Return the names of the height maps."""
    return console.library.height_maps()


@router.get("/height-maps/{name}")
def height_map(name: str, console: Shared) -> dict[str, Any]:
    """Return a height map."""
    return console.library.height_map(name).model_dump(mode="json")


@router.delete("/height-maps/{name}")
def remove_height_map(name: str, console: Controlled) -> Accepted:
    """Remove a height map."""
    console.library.height_map_file(name).unlink()
    console.height_maps_changed(name)
    return Accepted()


@router.post("/height-maps/{name}/probe")
async def probe_height_map(name: str, body: ProbeGrid, console: Controlled) -> Accepted:
    """Begin to probe a grid; the event ``height-map`` ends it, and an alarm tells what failed."""
    grid = Grid(**body.model_dump(exclude={"system"}))
    return await accepted(await console.probe_grid(name, grid, body.system))


@router.post("/height-maps/{name}/again")
async def probe_points(name: str, body: ProbeAgain, console: Controlled) -> Accepted:
    """Begin to probe points of a height map again, as ``probe``."""
    points = tuple(body.points)
    surface = console.library.height_map(name)
    again = PointsAgain(surface=surface, **body.model_dump(exclude={"points"}), points=points)
    return await accepted(await console.probe_points(name, again))


# The requests about measurements: begin, result, write.


async def _begin_measurement(kind: Kind, body: OfMeasurement, console: Console) -> Accepted:
    options = body.model_dump(exclude={"probe", "feed", "unhomed"})
    probe, moves = None, Moves(None if body.feed is None else per_second(body.feed))
    if body.probe is not None:
        probe = TouchProbe(**body.probe.model_dump(exclude={"contact_feed"}))
        moves = moves._replace(contact_feed=body.probe.contact_feed)
    order = ORDERS[kind](**options, probe=probe)
    asked = OperatorSession.measure
    future = await ask(console, asked, order, moves._replace(unhomed=body.unhomed))
    console.measurement.begun(kind, future)
    return await accepted(future)


ORDERS: dict[str, Callable[..., Order]] = {"backlash": Backlash, "pitch": Pitch, "square": Square}


@router.post("/measure/backlash")
async def measure_backlash(body: MeasureBacklash, console: Controlled) -> Accepted:
    """Begin to measure the play of a nut; questions ``reading`` and ``todo`` come."""
    return await _begin_measurement("backlash", body, console)


@router.post("/measure/pitch")
async def measure_pitch(body: MeasurePitch, console: Controlled) -> Accepted:
    """Begin to measure the errors of a screw."""
    return await _begin_measurement("pitch", body, console)


@router.post("/measure/square")
async def measure_square(body: MeasureSquare, console: Controlled) -> Accepted:
    """Begin to measure the angle between two axes."""
    return await _begin_measurement("square", body, console)


@router.post("/measure/limits")
async def measure_limits(body: MeasureLimits, console: Controlled) -> Accepted:
    """Begin to raise the limits of an axis until it loses steps."""
    future = await ask(console, OperatorSession.measure_limits, body.axis, body.most)
    console.measurement.begun("limits", future)
    return await accepted(future)


@router.post("/measure/ringing")
async def measure_ringing(body: MeasureRinging, console: Controlled) -> Accepted:
    """Find the modes in a record, or in that of the board's accelerometer while an axis moves."""
    if body.axis is None:
        await asyncio.to_thread(console.measurement.find_modes, body.text, body.name)
        return Accepted()
    order, moves = Ringing(axis=body.axis), Moves(unhomed=body.unhomed)
    future = await ask(console, OperatorSession.measure, order, moves)
    console.measurement.begun("ringing", future)
    return await accepted(future)


@router.get("/measurement")
def measurement(console: Shared) -> dict[str, Any]:
    """Return the last measurement and its result."""
    return asdict(console.measurement.shown)


@router.post("/measurement/write")
def write_measurement(body: WriteMeasured, console: Controlled) -> dict[str, Any]:
    """Write the result that was shown into the machine file; return the measurement."""
    console.measurement.write(body.number)
    return asdict(console.measurement.shown)


@router.delete("/measurement")
def discard_measurement(console: Controlled) -> Accepted:
    """Forget the result."""
    console.measurement.discard()
    return Accepted()

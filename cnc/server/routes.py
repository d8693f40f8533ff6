"""The requests about the machine: control, motion, offsets, lines, settings."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict
from typing import Annotated, Any, Concatenate, ParamSpec, TypeVar

from fastapi import APIRouter, Depends, Header, HTTPException, Request

from cnc.boards.registry import board_names
from cnc.model import parameter_numbers as numbers
from cnc.model.units import per_minute
from cnc.operate.events import as_object
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import cycles, mdi_line
from cnc.operate.program_session import macro_names
from cnc.operate.session_access import begin_jog
from cnc.server.console import Console
from cnc.server.models import (
    Accepted,
    ChooseSystem,
    Connect,
    ControlKey,
    CycleRun,
    DialogAnswer,
    EnteredLine,
    Home,
    JogKeep,
    JogStart,
    JogStarted,
    JogStep,
    Override,
    Setting,
    SettingValue,
    TakeControl,
    Zero,
)
from cnc.version import __version__
from cnc.view.collect import stock_box

P = ParamSpec("P")
T = TypeVar("T")
QUICK = 0.05
"""Time in which a command that is refused at once is refused, s."""
MM_PER_MIN = 60.0


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
    feed = None if body.feed is None else body.feed / MM_PER_MIN
    return await accepted(
        await ask(console, OperatorSession.jog_step, body.distances, feed, unhomed=body.unhomed)
    )


@router.post("/jog/start")
async def jog_start(body: JogStart, console: Controlled) -> JogStarted:
    """Move until the release, or until the signs of life end."""
    feed = None if body.feed is None else body.feed / MM_PER_MIN
    jog = await ask(console, begin_jog, body.directions, feed, unhomed=body.unhomed)
    return JogStarted(jog=jog.id, feed=jog.feed * MM_PER_MIN)


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


@router.get("/macros")
async def macros(console: Shared) -> list[str]:
    """Return the names of the macros."""
    return macro_names(console.library.macros)


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
    await ask(console, OperatorSession.stop)
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
    return Accepted(accepted=await ask(console, OperatorSession.answer, body.dialog, body.yes))


@router.get("/settings")
async def settings(console: Shared) -> list[Setting]:
    """Return the settings of a GRBL board."""
    return [Setting(**asdict(each)) for each in await result(console, OperatorSession.settings)]


@router.put("/settings/{number}")
async def change_setting(number: int, body: SettingValue, console: Controlled) -> Accepted:
    """Write a setting, and read it back."""
    await result(console, OperatorSession.change_setting, number, body.value)
    return Accepted()

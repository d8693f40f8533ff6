"""What is at the serial ports: which board answers, its settings, and the machine file that they
make.

A port is asked as a GRBL board is, then, if that is not what answers, as a stepper board, whose
hello is no command to any other board.

A GRBL board tells its limits itself (``$$``), so nobody has to copy them. What it does not have is
jerk: the file's is such that an axis reaches its acceleration in JERK_TIME, which keeps the plan
close to the board's own ramps.

Everything that is printed but the machine file is a remark of TOML, so ``cncrun boards /dev/ttyUSB0
> mill.toml`` makes that file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from cnc.boards.grbl.link import GrblLink
from cnc.boards.grbl.settings import (
    ACCELERATIONS,
    ARC_TOLERANCE,
    JUNCTION_DEVIATION,
    NAMES,
    RATES,
    STEPS,
    BoardInfo,
)
from cnc.boards.grbl.status import Status
from cnc.boards.port import PortLost, SystemClock
from cnc.boards.protocols import board_error
from cnc.boards.serial_port import found_ports, open_port
from cnc.boards.stepper.connection import BAUD, Wire
from cnc.boards.stepper.protocol import VERSION, Welcome
from cnc.machine.models import AXIS_LETTERS
from cnc.model.diagnostics import BoardError
from cnc.model.units import per_second

JERK_TIME = 0.025
"""Seconds in which an axis reaches its acceleration."""
STEP_RATE = 30_000
"""Steps/s that GRBL makes on an Uno; the file has more where the board's settings ask for it."""
HOMING = 22
NOT_GRBL = ("no-answer", "board-not-grbl", "board-silent")
"""What is said of a port at which no GRBL board answers."""
AWAKE_S = 1.0
"""A stepper board that has heard a GRBL board's questions for seconds is up, and answers a hello
within this.
"""
SLOWEST = 250_000
"""Bits a second: the slowest that a stepper board is built for."""


@dataclass(frozen=True, slots=True)
class FoundBoard:
    """A port, what the system says of it, and either the board that answered or why none did.

    info, status: of a GRBL board. stepper: the name by which a stepper board has welcomed us, baud:
    at this speed.
    """

    port: str
    description: str
    info: BoardInfo | None = None
    status: Status | None = None
    stepper: Welcome | None = None
    baud: int = 0
    fault: BoardError | None = None


def probe_ports(ports: Sequence[str] = (), baud: int = 115200) -> list[FoundBoard]:
    """Ask the ports named, else all of this computer, all at once. The first opening of a port
    resets most boards; nothing moves.
    """
    known = {port.name: port.description for port in found_ports()}
    names = list(ports) or list(known)
    if not names:
        return []
    with ThreadPoolExecutor(len(names)) as pool:
        return list(pool.map(lambda name: _asked(name, known.get(name, ""), baud), names))


def _asked(name: str, description: str, baud: int) -> FoundBoard:
    try:
        port = open_port(name, baud)
    except BoardError as error:
        return FoundBoard(name, description, fault=error)
    link = GrblLink(port, SystemClock(), name)
    try:
        link.connect()
        return FoundBoard(name, description, link.info, link.status)
    except PortLost as error:
        return FoundBoard(name, description, fault=error)
    except BoardError as error:
        if error.diagnostic.code not in NOT_GRBL:
            return FoundBoard(name, description, fault=error)
        # A GRBL board was told to reset by now, if it is one: what it still had to do is over.
        speed = baud if baud >= SLOWEST else BAUD
        try:
            port.change_baud(speed)
            wire = Wire(port, SystemClock(), name)
            return FoundBoard(name, description, stepper=wire.greet(AWAKE_S), baud=speed)
        except BoardError:
            return FoundBoard(name, description, fault=error)
    finally:
        link.close()


def port_report(found: FoundBoard, baud: int = 115200) -> Iterator[str]:
    """What to print of a port, line by line: remarks, then the machine file."""
    yield f"# {found.port}  {found.description}".rstrip()
    info, status = found.info, found.status
    if found.stepper is not None:
        yield from _stepper(found, found.stepper)
        return
    if info is None or status is None:
        if found.fault is not None:
            yield f"# {found.fault.diagnostic.message}"
        return
    yield f"# {info.firmware}  {info.build}  {status.state}".rstrip()
    position = "  ".join(
        f"{letter.upper()} {value:.3f}"
        for letter, value in zip(AXIS_LETTERS, status.position or (), strict=False)
    )
    yield f"# machine position {position}"
    yield f"# planner {info.blocks or 'unknown'} blocks, receive buffer {info.rx_bytes} bytes, options {info.options or 'none'}"
    for number, value in sorted(info.settings.items()):
        yield f"# ${number} = {value}  {NAMES.get(number, '')}".rstrip()
    try:
        yield from machine_file(found.port, info, baud)
    except BoardError as error:
        yield f"# no machine file: {error.diagnostic.message}"


def _stepper(found: FoundBoard, board: Welcome) -> Iterator[str]:
    """What a stepper board tells. It knows nothing of the machine: its file is written by hand."""
    if board.version != VERSION:
        yield f"# stepper board, version {board.version} of the protocol; this program speaks {VERSION}: make flash PORT={found.port}"
        return
    letters, least_us = " ".join("XYZA"[: board.axes]), board.least_ticks * board.tick_ns / 1000
    position = "its position is known" if board.position_known else "it does not know its position"
    yield f"# stepper board, version {board.version} of the protocol  {board.state.name.lower()}"
    yield f"# {board.axes} axes ({letters}), ticks of {board.tick_ns} ns, grid moves at least {least_us:g} us apart"
    yield f"# room for {board.room} bytes of segments; {position}"
    yield f'# for its machine file: [board] kind = "stepper", port = {json.dumps(found.port)}, baud = {found.baud}'


def machine_file(port: str, info: BoardInfo, baud: int) -> Iterator[str]:
    """The machine file (TOML) by the board's settings. BoardError ``board-settings`` where it does
    not tell them.
    """
    text = ["", "[machine]", f"name = {json.dumps(info.firmware)}"]
    rates, most_steps = [], float(STEP_RATE)
    for column, letter in enumerate(AXIS_LETTERS[: info.axes]):
        steps, rate, acceleration = (
            info.axis(first, column) for first in (STEPS, RATES, ACCELERATIONS)
        )
        if steps is None or rate is None or acceleration is None:
            message = f"the board tells no ${STEPS + column}, ${RATES + column} or ${ACCELERATIONS + column} for its axis {letter.upper()}"
            raise board_error("board-settings", message, hint="set them on the board")
        rates.append(per_second(rate))
        most_steps = max(most_steps, per_second(rate) * steps)
        text += [
            "",
            f"[axes.{letter}]",
            f"steps_per_mm = {steps:.10g}  # ${STEPS + column}",
            f"max_velocity = {per_second(rate):.10g}  # ${RATES + column} = {rate:g} mm/min",
            f"max_acceleration = {acceleration:.10g}  # ${ACCELERATIONS + column}",
            f"max_jerk = {acceleration / JERK_TIME:.10g}  # GRBL has none; {JERK_TIME:g} s to the full acceleration",
        ]
        travel = info.travel(column)
        if travel is not None:
            text.append(f"travel = [{travel[0]:.10g}, {travel[1]:.10g}]")
    if not rates:
        raise board_error(
            "board-settings",
            "the board tells no settings of its axes",
            hint="is its firmware GRBL 1.1 or grblHAL?",
        )
    if info.number(HOMING) in (None, 0.0):
        text += [
            "",
            "# The board does not home ($22=0): machine zero is where it stood when it was switched on.",
            "# Mend the travel accordingly.",
        ]
    text += ["", "[path]", f"max_feed = {max(rates):.10g}"]
    for key, setting in (("chord_error", ARC_TOLERANCE), ("tolerance", JUNCTION_DEVIATION)):
        value = info.number(setting)
        if value:
            text.append(f"{key} = {value:.10g}  # ${setting}")
    text += ["", "[board]", 'kind = "grbl"', f"port = {json.dumps(port)}", f"baud = {baud}"]
    text += [f"max_step_rate = {math.ceil(most_steps)}"]
    yield from text

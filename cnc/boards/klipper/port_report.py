"""The report on a Klipper board at a port, with a skeleton of its machine file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import pin_ranges
from cnc.boards.klipper.protocol.dictionary import Dictionary
from cnc.boards.klipper.simulator.firmware import FIRMWARES

AXES = "xyz"
EXAMPLE = {"steps_per_mm": 80, "max_velocity": 50, "max_acceleration": 500, "max_jerk": 10_000}
"""Keys of an axis, with examples of their values."""


@dataclass(frozen=True, slots=True)
class KlipperInfo:
    """A board: its dictionary, its state, and the entries of its move queue.

    A board that is not configured has no queue yet: 0 entries.
    """

    dictionary: Dictionary
    slots: int
    configured: bool
    shut_down: bool


def read_info(connection: Connection, timeout: float) -> KlipperInfo:
    """Identify the board on a connection. Nothing moves, and nothing is configured.

    Raises:
        BoardError: No Klipper board answers.
    """
    connection.open(timeout)
    config = connection.ask("get_config", "config", connection.pump)
    return KlipperInfo(
        connection.dictionary,
        config["move_count"],
        bool(config["is_config"]),
        bool(config["is_shutdown"]),
    )


def klipper_report(port: str, board: KlipperInfo, baud: int) -> Iterator[str]:
    """Yield the lines of the report: comments of TOML, then the tables of a machine file.

    Args:
        port: Name of the serial port.
        board: The board.
        baud: Speed of the port, bits/s.
    """
    known = board.dictionary
    frequency = known.constant("CLOCK_FREQ", 0.0) / 1e6
    state = "shut down" if board.shut_down else "configured" if board.configured else "ready"
    yield f"# Klipper firmware {known.version}  {known.constants.get('MCU', '')}  {state}"
    queue = f"{board.slots} entries" if board.slots else "size known after configuration"
    yield f"# clock {frequency:g} MHz, move queue: {queue}"
    yield f"# pins: {pin_ranges(known.enumerations.get('pin', {}))}"
    buses = known.enumerations.get("spi_bus", {})
    if buses:
        yield f"# SPI buses: {', '.join(buses)}"
    yield "# A machine file for it. Replace every STEP_X, DIR_X and so on by a pin of your board,"
    yield "# and every number by that of your machine; until then nothing can move."
    yield "[board]"
    yield f'kind = "klipper"\nport = {json.dumps(port)}\nbaud = {baud}'
    if model := _model(known):
        yield f'\n[board.klipper]\nmcu = "{model}"'
    for letter in AXES:
        upper = letter.upper()
        yield f"\n[board.klipper.{letter}]"
        yield f'step = "STEP_{upper}"\ndirection = "DIR_{upper}"'
        yield f'enable = "!ENABLE_{upper}"\nendstop = "^ENDSTOP_{upper}"'
    for letter in AXES:
        yield f"\n[axes.{letter}]"
        yield from (f"{key} = {value}" for key, value in EXAMPLE.items())


def _model(known: Dictionary) -> str:
    """Return the name of the model of a microcontroller, "" if there is none."""
    mcu = known.constants.get("MCU")
    return next((name for name, each in FIRMWARES.items() if each.mcu == mcu), "")

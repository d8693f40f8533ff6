"""The report on a GRBL board at a port: its settings, and the machine file that they give.

GRBL reports its limits (``$$``) but has no limit of jerk. The machine file gets a jerk at which an
axis reaches its acceleration in JERK_TIME, so that a plan stays close to the board's own ramps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import tomlkit
from tomlkit.items import Item, Table

from cnc.boards.errors import board_error
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
from cnc.model.blocks import AXIS_LETTERS, AxisLetter
from cnc.model.diagnostics import BoardError
from cnc.model.units import per_second

JERK_TIME = 0.025
"""Time in which an axis reaches its acceleration, s."""
STEP_RATE = 30_000
"""Step rate of GRBL on an Uno, steps/s; the file has more where the settings need more."""


def grbl_report(port: str, info: BoardInfo, status: Status, baud: int) -> Iterator[str]:
    """Yield the lines of the report: comments of TOML, then the machine file."""
    yield f"# {info.firmware}  {info.build}  {status.state}".rstrip()
    position = "  ".join(
        f"{letter.upper()} {value:.3f}"
        for letter, value in zip(AXIS_LETTERS, status.position or (), strict=False)
    )
    yield f"# machine position {position}"
    yield (
        f"# planner {info.blocks or 'unknown'} blocks, receive buffer {info.rx_bytes} bytes, "
        f"options {info.options or 'none'}"
    )
    if info.extensions:
        yield f"# extensions {', '.join(sorted(info.extensions))}"
    for line in info.about:
        yield f"# {line}"
    for number, value in sorted(info.settings.items()):
        yield f"# ${number} = {value}  {NAMES.get(number, '')}".rstrip()
    try:
        yield from machine_file(port, info, baud).splitlines()
    except BoardError as error:
        yield f"# no machine file: {error.diagnostic.message}; {error.diagnostic.hint}"


def machine_file(port: str, info: BoardInfo, baud: int) -> str:
    """Return the machine file (TOML) that the settings of a board give.

    Args:
        port: Name of the serial port.
        info: Firmware and settings of the board.
        baud: Speed of the port, bits/s.

    Raises:
        BoardError: ``board-settings``, where the board does not report the settings of its axes.
    """
    letters = AXIS_LETTERS[: info.axes]
    if not letters and info.fluid:
        message = "FluidNC keeps its settings in a file (config.yaml)"
        hint = "write a machine file with the steps_per_mm, rates and travel of that file"
        raise board_error("board-settings", message, hint=hint)
    if not letters:
        raise board_error(
            "board-settings",
            "the board does not report the settings of its axes",
            hint="is its firmware GRBL 1.1 or grblHAL?",
        )
    file = tomlkit.document()
    file.add(tomlkit.nl())
    header = tomlkit.table()
    header.add("name", info.firmware)
    if info.laser:
        header.add("kind", "laser")
    header.add(tomlkit.nl())
    file.add("machine", header)
    rates, step_rates = [], [float(STEP_RATE)]
    axes = tomlkit.table(is_super_table=True)
    for column, letter in enumerate(letters):
        steps, rate, acceleration = _axis_settings(info, column, letter)
        rates.append(rate)
        step_rates.append(rate * steps)
        axes.add(letter, _axis(info, column, (steps, rate, acceleration)))
    file.add("axes", axes)
    if not info.homes:
        file.add(tomlkit.comment("The board does not home ($22=0): machine zero is its position"))
        file.add(tomlkit.comment("at power-up, and the ends of the travel are not known."))
        file.add(tomlkit.nl())
    path = tomlkit.table()
    path.add("max_feed", _number(max(rates)))
    for key, setting in (("chord_error", ARC_TOLERANCE), ("tolerance", JUNCTION_DEVIATION)):
        value = info.number(setting)
        if value:
            path.add(key, _number(value, f"${setting}"))
    path.add(tomlkit.nl())
    file.add("path", path)
    step_rate = math.ceil(max(step_rates))
    file["board"] = {"kind": "grbl", "port": port, "baud": baud, "max_step_rate": step_rate}
    return tomlkit.dumps(file)


def _axis_settings(info: BoardInfo, column: int, letter: AxisLetter) -> tuple[float, float, float]:
    """Return steps/mm, velocity in mm/s and acceleration in mm/s^2 of an axis."""
    steps, rate, acceleration = (
        info.axis(first, column) for first in (STEPS, RATES, ACCELERATIONS)
    )
    if steps is None or rate is None or acceleration is None:
        numbers = f"${STEPS + column}, ${RATES + column} or ${ACCELERATIONS + column}"
        message = f"the board does not report {numbers} of its axis {letter.upper()}"
        raise board_error("board-settings", message, hint="set them on the board")
    return steps, per_second(rate), acceleration


def _axis(info: BoardInfo, column: int, settings: tuple[float, float, float]) -> Table:
    """Return the table of an axis."""
    steps, rate, acceleration = settings
    minute_rate = info.axis(RATES, column)
    table = tomlkit.table()
    table.add("steps_per_mm", _number(steps, f"${STEPS + column}"))
    table.add("max_velocity", _number(rate, f"${RATES + column} = {minute_rate:g} mm/min"))
    table.add("max_acceleration", _number(acceleration, f"${ACCELERATIONS + column}"))
    jerk = f"GRBL has none; {JERK_TIME:g} s to the full acceleration"
    table.add("max_jerk", _number(acceleration / JERK_TIME, jerk))
    travel = info.travel(column) if info.homes else None
    if travel is not None:
        table.add("travel", tomlkit.value(f"[{travel[0]:.10g}, {travel[1]:.10g}]"))
    table.add(tomlkit.nl())
    return table


def _number(value: float, comment: str = "") -> Item:
    """Return a number with ten digits, and a comment."""
    item = tomlkit.value(f"{value:.10g}")
    if comment:
        item.comment(comment)
        item.trivia.comment_ws = "  "
    return item

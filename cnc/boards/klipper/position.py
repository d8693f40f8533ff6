"""Position of a machine on a Klipper board: counts of the motors, and the file between runs.

The configuration of the board when it is opened stands here too, because it sets the counts.
"""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import BY_HOST, Layout, MotorObject
from cnc.boards.klipper.protocol import Message
from cnc.boards.protocols import board_error
from cnc.boards.pulse_board import MachinePosition
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, Diagnostic
from cnc.model.state_file import folder, read_state


class MotorPosition(MachinePosition):
    """Conversion between the counts of motors and the grid points of a machine.

    Attributes:
        offset: Grid point minus count, for each motor.
        moving: Whether each motor takes part in the motion.
    """

    def __init__(self, machine: Machine, motors: list[MotorObject]) -> None:
        super().__init__(machine)
        self._motors = motors
        self.offset = [0] * len(motors)
        self.moving = [True] * len(motors)

    def select(self, alone: tuple[int, int] | None) -> None:
        """Let one motor of an axis (column, motor) take part in the motion, or all."""
        self.moving = [
            alone is None or motor.column != alone[0] or motor.number == alone[1]
            for motor in self._motors
        ]

    def counts(self, positions: list[int]) -> list[int]:
        """Return the counts of the motors in the directions of their axes."""
        return [
            count if motor.forward else -count
            for count, motor in zip(positions, self._motors, strict=True)
        ]

    def set(self, positions: list[int], grid: NDArray[np.int64]) -> None:
        """Set the grid point (axes,) at which the motors have these positions."""
        self.offset = [
            int(grid[motor.column]) - count
            for count, motor in zip(self.counts(positions), self._motors, strict=True)
        ]

    def of(self, positions: list[int]) -> NDArray[np.int64]:
        """Return the grid point (axes,) of positions; of several motors that move the first."""
        grid = np.zeros(len(self.letters), np.int64)
        for motor, count, offset, moving in reversed(
            list(zip(self._motors, self.counts(positions), self.offset, self.moving, strict=True))
        ):
            if moving:
                grid[motor.column] = count + offset
        return grid

    def differing(self, positions: list[int]) -> str:
        """Return the letters of the axes whose motors do not agree, "" if all do."""
        grid = self.of(positions)
        return " ".join(
            sorted(
                {
                    self.letters[motor.column]
                    for motor, count, offset, moving in zip(
                        self._motors, self.counts(positions), self.offset, self.moving, strict=True
                    )
                    if moving and count + offset != grid[motor.column]
                }
            )
        )

    def letter(self, column: int) -> str:
        """Return the letter of an axis."""
        return self.letters[column]


# Position of the machine on a Klipper board, kept on disk between runs.
#
# A board counts its steps from its configuration on, and no position can be sent to it. So the grid
# point at count 0 of each motor is kept here. The board stores a random number with its
# configuration. It forgets the number with its counts, when it is reset or configured by another
# program.
#
#     STATE/BOARD.klipper.json: `layout`, `number`, `offset` [...], `known` [...], `moving`
#
# `moving` is true while a program runs. If it is still true later, that program was killed, and the
# motors stopped without a ramp.

Unsigned = Annotated[int, Field(ge=0, lt=1 << 32)]
GridPoint = Annotated[int, Field(gt=-(1 << 53), lt=1 << 53)]


class StoredPosition(BaseModel):
    """Content of the file.

    Attributes:
        layout: Checksum of the configuration.
        number: Number that the board stores with it.
        offset: Grid point at count 0 of each motor.
        known: Whether the position of each axis is known.
        moving: Whether a program runs.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)

    layout: Unsigned
    number: Unsigned
    offset: list[GridPoint]
    known: list[bool]
    moving: bool


class PositionStore:
    """The file of one board; without an identity nothing is kept.

    Args:
        board: Identity of the board, "" for none.
    """

    def __init__(self, board: str = "") -> None:
        self._file: Path | None = None
        if board:
            self._file = folder() / f"{quote(board, safe='')}.klipper.json"

    def read(self) -> tuple[StoredPosition | None, list[Diagnostic]]:
        """Return the content, None if there is none that can be used, and warnings."""
        if self._file is None:
            return None, []
        return read_state(self._file, StoredPosition, "home the machine: its position is not known")

    def write(self, content: StoredPosition) -> None:
        """Replace the file. A failure does not stop the machine."""
        if self._file is None:
            return
        with contextlib.suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            new = self._file.with_suffix(".new")
            with new.open("w", encoding="utf-8") as file:
                file.write(content.model_dump_json())
                file.flush()
                os.fsync(file.fileno())
            new.replace(self._file)

    def number(self, layout: int) -> int:
        """Return a number for a new configuration; without a file always the same."""
        return layout if self._file is None else secrets.randbits(32) or 1


# Configuration of a Klipper board when it is opened.

log = logging.getLogger(__name__)

LEFT_OVER = "oids already allocated"
"""The firmware's reason for a refusal while it still has a part of a configuration.

A program that was refused, or that ended while it configured the board, leaves that.
"""
FOREIGN = "Invalid oid type"
"""The firmware's reason for a command to an object that it does not have: its memory is damaged."""
PINS = "check the pins in the machine file; the firmware's manual tells what they can"
KEPT, SWITCH_OFF = "it keeps another configuration", "switch it off and on"


def shutdown_reason(connection: Connection, number: int) -> str:
    """Return the board's own text for the reason of a shutdown."""
    names = connection.dictionary.enumerations.get("static_string_id", {})
    return next((name for name, listed in names.items() if listed == number), f"reason {number}")


def configure(connection: Connection, layout: Layout, kept: int, new: int) -> tuple[int, bool]:
    """Configure the board, unless it has this configuration already.

    Args:
        connection: The connection.
        layout: The objects of the board.
        kept: Number that the board has stored, if it has this configuration.
        new: Number for a new configuration.

    Returns:
        Entries of its move queue, and whether it kept its configuration and so its positions.

    Raises:
        BoardError: ``klipper-configuration``, if the board refuses it.
    """
    config, damaged = _config(connection), False
    if config["is_shutdown"]:
        damaged = _reason(connection) == FOREIGN
        connection.send("clear_shutdown")
        config = _config(connection)
    if config["is_config"] and config["crc"] == kept and not config["is_shutdown"]:
        if not damaged and _is_sound(connection, layout):
            return config["move_count"], True
        log.warning("%s has lost parts of its configuration; it is reset", connection.name)
    reason = LEFT_OVER
    if not (config["is_config"] or config["is_shutdown"]):
        reason = _write(connection, layout, new)
    if reason == LEFT_OVER:
        _forget(connection)
        reason = _write(connection, layout, new)
    if reason:
        raise _refused(connection, reason, PINS)
    config = _config(connection)
    if not config["is_config"] or config["is_shutdown"]:
        raise _refused(connection, "it is not configured", SWITCH_OFF)
    return config["move_count"], False


def _reason(connection: Connection) -> str:
    """Return the reason of the shutdown that a board is in."""
    # The board does not carry the command out, and says why.
    answer = connection.ask("allocate_oids", "is_shutdown", connection.pump, count=0)
    return shutdown_reason(connection, answer["static_string_id"])


def _is_sound(connection: Connection, layout: Layout) -> bool:
    """Return whether a configured board has its objects; motors that still move are stopped."""

    class Shutdown(Exception):
        """The board has shut down, because it lacks an object."""

    def pump(seconds: float) -> list[Message]:
        messages = connection.pump(seconds)
        if any(message.name in ("shutdown", "is_shutdown") for message in messages):
            raise Shutdown
        return messages

    ask = connection.ask
    try:
        ask("trsync_trigger", "trsync_state", pump, oid=layout.trigger, reason=BY_HOST)
        for motor in layout.motors:
            ask("stepper_get_position", "stepper_position", pump, oid=motor.oid)
        for switch in layout.inputs:
            ask("endstop_query_state", "endstop_state", pump, oid=switch.oid)
    except Shutdown:
        return False
    return True


def _write(connection: Connection, layout: Layout, number: int) -> str:
    """Write a configuration; return the reason of a refusal, "" if there is none."""
    reasons: list[str] = []

    def pump(seconds: float) -> None:
        for message in connection.pump(seconds):
            if message.name in ("shutdown", "is_shutdown"):
                reasons.append(shutdown_reason(connection, message["static_string_id"]))

    connection.send("allocate_oids", count=layout.objects)
    for command in layout.config:
        connection.link.send(command)
    connection.send("finalize_config", crc=number)
    connection.flush(pump)
    return reasons[0] if reasons else ""


def _forget(connection: Connection) -> None:
    """Let the board forget its configuration: few can do that without a restart."""
    commands = connection.dictionary.command_names
    if "config_reset" in commands:
        connection.send("emergency_stop")
        # The firmware drops the rest of a block in which it shuts down.
        connection.flush(connection.pump)
        connection.send("config_reset")
        try:
            config = _config(connection)
        except BoardError:
            connection.reconnect()
            config = _config(connection)
    elif "reset" in commands:
        connection.reset()
        config = _config(connection)
    else:
        raise _refused(connection, KEPT, SWITCH_OFF)
    if config["is_config"] or config["is_shutdown"]:
        raise _refused(connection, KEPT, SWITCH_OFF)


def _config(connection: Connection) -> Message:
    return connection.ask("get_config", "config", connection.pump)


def _refused(connection: Connection, reason: str, hint: str) -> Exception:
    message = f"the board on {connection.name} refuses its configuration: {reason}"
    return board_error("klipper-configuration", message, hint=hint)


# The position that a Klipper board and the file of the last program have kept together.


class PositionKeeper:
    """The stored position of one board.

    Args:
        identity: Identity of the board, "" for one whose position is not kept.
        layout: The objects of the board.

    Attributes:
        warnings: Findings about the file.
    """

    def __init__(self, identity: str, layout: Layout) -> None:
        self._layout = layout
        self._store = PositionStore(identity)
        self._stored, self.warnings = self._store.read()
        self._number = 0

    def configure(self, connection: Connection) -> tuple[int, bool]:
        """Configure the board, unless it has this configuration already.

        Returns:
            Entries of its move queue, and whether it has kept its counts.
        """
        layout, stored = self._layout.crc, self._stored
        kept = stored.number if stored is not None and stored.layout == layout else layout
        self._number = self._store.number(layout)
        slots, same = configure(connection, self._layout, kept, self._number)
        if same:
            self._number = kept
        return slots, same

    def restore(self, position: MotorPosition) -> None:
        """Take over the stored position, if it belongs to the counts of the board."""
        stored = self._stored
        if stored is None or len(stored.offset) != len(self._layout.motors):
            return
        position.offset = list(stored.offset)
        # A program that was killed has left the motors without a ramp.
        if len(stored.known) == len(position.known) and not stored.moving:
            position.known = np.array(stored.known, np.bool_)

    def write(self, position: MotorPosition, *, moving: bool) -> None:
        """Keep the position for the next program."""
        certain, offset = position.known.tolist(), list(position.offset)
        self._store.write(
            StoredPosition(
                layout=self._layout.crc,
                number=self._number,
                offset=offset,
                known=certain,
                moving=moving,
            )
        )

"""Configuration of a Klipper board when it is opened."""

from __future__ import annotations

import logging

from cnc.boards.errors import board_error
from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import BY_HOST, Layout
from cnc.boards.klipper.protocol.dictionary import Message
from cnc.model.diagnostics import BoardError

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
    return next((name for name, known in names.items() if known == number), f"reason {number}")


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
        for each in layout.inputs:
            ask("endstop_query_state", "endstop_state", pump, oid=each.oid)
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
    known = connection.dictionary.command_names
    if "config_reset" in known:
        connection.send("emergency_stop")
        # The firmware drops the rest of a block in which it shuts down.
        connection.flush(connection.pump)
        connection.send("config_reset")
        try:
            config = _config(connection)
        except BoardError:
            connection.reconnect()
            config = _config(connection)
    elif "reset" in known:
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

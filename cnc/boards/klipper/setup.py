"""Configuration of a Klipper board when it is opened."""

from __future__ import annotations

from cnc.boards.errors import board_error
from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import Layout
from cnc.boards.klipper.protocol.dictionary import Message
from cnc.model.diagnostics import BoardError

LEFT_OVER = "oids already allocated"
"""The firmware's reason for a refusal while it still has a part of a configuration.

A program that was refused, or that ended while it configured the board, leaves that.
"""
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
    config = _config(connection)
    if config["is_shutdown"]:
        connection.send("clear_shutdown")
        config = _config(connection)
    if config["is_config"] and config["crc"] == kept and not config["is_shutdown"]:
        return config["move_count"], True
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

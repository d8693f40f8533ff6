"""Configuration of a Klipper board when it is opened."""

from __future__ import annotations

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import Layout
from cnc.boards.klipper.protocol.dictionary import Message
from cnc.boards.protocols import board_error


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
    if config["is_config"] or config["is_shutdown"]:
        # Only a board in shutdown can be configured anew without a reset.
        connection.send("emergency_stop")
        connection.send("config_reset")
        config = _config(connection)
        if config["is_config"] or config["is_shutdown"]:
            raise _refused(connection, "it keeps another configuration", "switch it off and on")
    connection.send("allocate_oids", count=layout.objects)
    for command in layout.config:
        connection.link.send(command)
    connection.send("finalize_config", crc=new)
    connection.flush(lambda seconds: _checked(connection, connection.pump(seconds)))
    config = _config(connection)
    if not config["is_config"] or config["is_shutdown"]:
        raise _refused(connection, "it is not configured", "switch it off and on")
    return config["move_count"], False


def _config(connection: Connection) -> Message:
    return connection.ask("get_config", "config", connection.pump)


def _checked(connection: Connection, messages: list[Message]) -> None:
    """Raise a fault if the board has shut down."""
    for message in messages:
        if message.name in ("shutdown", "is_shutdown"):
            reason = shutdown_reason(connection, message["static_string_id"])
            hint = "check the pins in the machine file; the firmware's manual tells what they can"
            raise _refused(connection, reason, hint)


def _refused(connection: Connection, reason: str, hint: str) -> Exception:
    message = f"the board on {connection.name} refuses its configuration: {reason}"
    return board_error("klipper-configuration", message, hint=hint)

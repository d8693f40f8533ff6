"""What a board reports while it is being stopped, and the end of a shutdown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import BY_HOST
from cnc.boards.klipper.outputs import Outputs
from cnc.boards.klipper.protocol.dictionary import Message

ATTEMPTS = 4
"""Shutdowns after which the board is not asked any more: a late output may shut it down again."""


class ShutDownAgain(Exception):
    """A question came to a board that has shut down, which answers few questions."""


@dataclass(slots=True)
class Stop:
    """Reports during a stop: the motors may have stopped before their ramp ended.

    Attributes:
        shutdown: Number of the reason of a shutdown, 0 for none.
        trigger: Reason of a trigger that was not the host's, 0 for none.
        reading: Whether a shutdown raises ShutDownAgain.
        ramp: Whether the motors still follow their ramp to rest.
    """

    shutdown: int = 0
    trigger: int = 0
    reading: bool = False
    ramp: bool = False

    @property
    def dead(self) -> bool:
        """Whether something else than the host has stopped the motors."""
        return bool(self.shutdown or self.trigger)

    def take(self, message: Message, *, triggered: bool) -> None:
        """Take a message; ``triggered``: it tells of a trigger of this motion.

        Raises:
            ShutDownAgain: The board has shut down, and an answer is waited for.
        """
        if message.name in ("shutdown", "is_shutdown"):
            self.shutdown = message["static_string_id"]
            if self.reading:
                raise ShutDownAgain
        elif triggered and message["trigger_reason"] not in (0, BY_HOST):
            self.trigger = message["trigger_reason"]

    def ask(
        self,
        connection: Connection,
        outputs: Outputs,
        question: Callable[[], list[int]],
        pump: Callable[[float], list[Message]],
    ) -> list[int]:
        """Return the answer to a question, after the end of each shutdown.

        Raises:
            BoardError: The board does not answer.
        """
        for _ in range(ATTEMPTS):
            if connection.ask("get_config", "config", pump)["is_shutdown"]:
                connection.send("clear_shutdown")
                connection.flush(pump)
                outputs.forget()
            self.reading = True
            try:
                return question()
            except ShutDownAgain:
                continue
            finally:
                self.reading = False
        raise connection.silent()

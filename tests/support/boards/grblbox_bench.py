"""A bench for the board in the box: send, let time pass, see what came."""

from cnc.boards.grbl.simulator.box import GrblBox
from cnc.boards.grbl.simulator.firmware_profile import GRBL, Flavour
from cnc.boards.grbl.simulator.ports import BoxPort
from cnc.boards.grbl.simulator.workpiece import World

BYTE = 10 / 115200
"""Seconds of a byte on the wire."""


class Bench:
    """A board that has been switched on."""

    def __init__(
        self,
        flavour: Flavour = GRBL,
        settings: dict[int, float] | None = None,
        world: World | None = None,
    ) -> None:
        self.box = GrblBox(flavour, settings=settings, world=world)
        self.port = BoxPort(self.box)
        self.welcome = self.hear(2.0)

    def hear(self, seconds: float) -> list[str]:
        """Lines that come within that time."""
        end, heard = self.box.now + seconds, b""
        while self.box.now < end:
            heard += self.port.read(end - self.box.now)
        return [line for line in heard.decode("latin-1").split("\r\n") if line]

    def send(self, text: str | bytes, seconds: float = 1.0) -> list[str]:
        """Send bytes, or a text in Latin-1; lines that come within that time."""
        self.port.write(text if isinstance(text, bytes) else text.encode("latin-1"))
        return self.hear(seconds)

    def reply(self, line: str, seconds: float = 1.0) -> str:
        """The answer to one line."""
        (reply,) = (
            heard
            for heard in self.send(line + "\n", seconds)
            if heard == "ok" or heard.startswith("error:")
        )
        return reply

    def status(self) -> dict[str, str]:
        """A status report by field; the state is field ``state``."""
        (report,) = (heard for heard in self.send("?", 0.02) if heard.startswith("<"))
        state, *fields = report[1:-1].split("|")
        return {"state": state} | dict(field.split(":", 1) for field in fields)

    def finish(self) -> None:
        """Until the motion has ended."""
        while self.box.core.planner.blocks or self.box.core.state == "Run":
            self.hear(0.25)

"""A test bench for the GRBL simulator: send lines, advance time, read answers."""

from cnc.simulators.grbl.firmware_profile import GRBL, FirmwareProfile
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from cnc.simulators.grbl.workpiece import Environment, HalfSpace, Workpiece

BYTE = 10 / 115200
"""Time of a byte on the wire, s."""
HOMING = {
    20: 1.0,
    22: 1.0,
    25: 5000.0,
    24: 500.0,
    110: 5000.0,
    111: 5000.0,
    112: 5000.0,
    120: 500.0,
    121: 500.0,
    122: 500.0,
}
"""Settings of a fast machine that can home."""


def material_below(level: float) -> Environment:
    """Return an environment with material below a height of Z, mm."""
    return Environment(workpiece=Workpiece((HalfSpace((0.0, 0.0, 1.0), level),)))


class Bench:
    """A simulated board with power."""

    def __init__(
        self,
        profile: FirmwareProfile = GRBL,
        settings: dict[int, float] | None = None,
        environment: Environment | None = None,
    ) -> None:
        self.simulator = GrblSimulator(profile, settings=settings, environment=environment)
        self.port = GrblSimulatorPort(self.simulator)
        self.welcome = self.hear(2.0)

    def hear(self, seconds: float) -> list[str]:
        """Return the lines that come within a time."""
        end, heard = self.simulator.now + seconds, b""
        while self.simulator.now < end:
            heard += self.port.read(end - self.simulator.now)
        return [line for line in heard.decode("latin-1").split("\r\n") if line]

    def send(self, text: str | bytes, seconds: float = 1.0) -> list[str]:
        """Send bytes, or a text in Latin-1; return the lines that come within a time."""
        self.port.write(text if isinstance(text, bytes) else text.encode("latin-1"))
        return self.hear(seconds)

    def reply(self, line: str, seconds: float = 1.0) -> str:
        """Return the answer to one line."""
        (reply,) = (
            heard
            for heard in self.send(line + "\n", seconds)
            if heard == "ok" or heard.startswith("error:")
        )
        return reply

    def status(self) -> dict[str, str]:
        """Return a status report by field; the state is field ``state``."""
        (report,) = (heard for heard in self.send("?", 0.02) if heard.startswith("<"))
        state, *fields = report[1:-1].split("|")
        return {"state": state} | dict(field.split(":", 1) for field in fields)

    def finish(self) -> None:
        """Wait until the motion has ended."""
        while self.simulator.core.planner.blocks or self.simulator.core.state == "Run":
            self.hear(0.25)

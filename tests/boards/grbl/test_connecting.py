"""Connection to a GRBL board: other devices, wrong baud rates, its settings and buffer."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.messages import Feedback, Firmware, Setting
from cnc.boards.grbl.settings import BoardInfo
from cnc.boards.port import SystemClock
from cnc.model.diagnostics import BoardError
from cnc.simulators.grbl.firmware_profile import GRBL, GRBLHAL, FirmwareProfile
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from cnc.simulators.grbl.workpiece import Environment
from tests.support.boards.grbl_rig import MACHINE, connected, started
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, feed


class Device:
    """A device that is not a GRBL board.

    It sends ``greeting`` and echoes received bytes, or sends nothing.
    """

    def __init__(self, greeting: bytes, answer: bytes = b"") -> None:
        self.time = 0.0
        self.greeting = greeting
        self.answer = answer
        self.heard = b""

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    def read(self, timeout: float) -> bytes:
        self.time += max(timeout, 1e-4)
        said, self.greeting = self.greeting, b""
        return said

    def write(self, data: bytes) -> None:
        self.heard += data
        self.greeting += self.answer

    def raise_lines(self) -> bool:
        return False

    def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("greeting", "answer", "code"),
    [
        (b"", b"", "no-answer"),
        (b"start\r\necho:Marlin 2.1.2\r\n", b"", "board-not-grbl"),
        (b"Smoothie\r\nok\r\n", b"ok\r\n", "board-not-grbl"),
        (b"\xe0\x1c\x82\xfe\n\x00\xfc\x1c\xe0\n", b"\xe0", "board-not-grbl"),
        (b"\r\nGrbl 0.9j ['$' for help]\r\n", b"", "board-too-old"),
        (b"<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>\r\n", b"", "board-too-old"),
        (b"\r\nGrbl 3.7 [FluidNC v3.7.0 (wifi) '$' for help]\r\n", b"", "no-answer"),
        (b"\r\nGrbl 1.1h ['$' for help]\r\n", b"", "no-answer"),
        (b"<Run|MPos:1.000,0.000,0.000|FS:500,0>\r\n", b"", "board-busy"),
    ],
)
def test_other_boards_are_refused_before_motion(greeting: bytes, answer: bytes, code: str) -> None:
    device = Device(greeting, answer)
    board = GrblBoard(device, MACHINE, device, "/dev/ttyUSB0")
    with pytest.raises(BoardError) as caught:
        board.connect()
    assert caught.value.diagnostic.code == code
    assert caught.value.diagnostic.hint
    # Half a second is left for the start of the command, and for the questions of other boards.
    assert device.time < (12.0 if b"Grbl" in greeting else 2.7)
    # Nothing but questions and a reset was sent.
    assert set(device.heard) <= set(b"?\x18\n")


class Marlin(Device):
    """Firmware that answers lines only."""

    def __init__(self) -> None:
        super().__init__(b"")
        self.line = b""

    def write(self, data: bytes) -> None:
        super().write(data)
        *lines, self.line = (self.line + data).split(b"\n")
        for line in lines:
            self.greeting += b'echo:Unknown command: "' + line + b'"\nok\n'


def test_firmware_that_answers_lines_only_is_shown() -> None:
    device = Marlin()
    board = GrblBoard(device, MACHINE, device, "/dev/ttyUSB0")
    with pytest.raises(BoardError) as caught:
        board.connect()
    assert "it sends 'echo:Unknown command" in caught.value.diagnostic.message
    assert device.time < 2.7


class WithOldReport(GrblSimulatorPort):
    """The port of a board that another process used a moment ago; it holds a report from then."""

    def __init__(self, simulator: GrblSimulator, state: str) -> None:
        super().__init__(simulator, hang_up=False)
        self.old = f"<{state}|MPos:1.000,0.000,0.000|FS:500,0>\r\n".encode()

    def read(self, timeout: float) -> bytes:
        old, self.old = self.old, b""
        return old or super().read(timeout)


def used_before(lines: bytes) -> GrblSimulator:
    """Return a board that greeted long ago and has some lines; its DTR stays up."""
    simulator = GrblSimulator()
    port = GrblSimulatorPort(simulator, hang_up=False)
    port.clock.sleep(3.0)
    port.write(lines)
    port.clock.sleep(1.0)
    while port.read(0.0):
        pass
    return simulator


def test_an_old_report_of_a_motion_does_not_count() -> None:
    simulator = used_before(b"G1 X1 F6000\n")
    port = WithOldReport(simulator, "Run")
    board = GrblBoard(port, MACHINE, port.clock, "/dev/ttyUSB0")
    board.connect()
    assert simulator.position[0] == pytest.approx(1.0)


def test_an_old_report_of_rest_does_not_count() -> None:
    simulator = used_before(b"G1 X100 F600\n")
    port = WithOldReport(simulator, "Idle")
    board = GrblBoard(port, MACHINE, port.clock, "/dev/ttyUSB0")
    with pytest.raises(BoardError) as caught:
        board.connect()
    assert caught.value.diagnostic.code == "board-busy"
    # It was not reset: the motion goes on.
    port.clock.sleep(12.0)
    assert simulator.position[0] == pytest.approx(100.0)


class OtherBaud:
    """A port at another baud rate than the board: each side samples the bits of the other."""

    def __init__(self, port: GrblSimulatorPort, ours: float, theirs: float = 115200.0) -> None:
        self.port, self.ours, self.theirs = port, ours, theirs

    def read(self, timeout: float) -> bytes:
        return resampled(self.port.read(timeout), self.theirs, self.ours)

    def write(self, data: bytes) -> None:
        self.port.write(resampled(data, self.ours, self.theirs))

    def raise_lines(self) -> bool:
        return self.port.raise_lines()

    def close(self) -> None:
        self.port.close()


def resampled(data: bytes, sent: float, received: float) -> bytes:
    """Return the bytes that a UART (8N1) reads from bytes that were sent at another rate.

    It looks for a falling edge, and samples each bit in its middle by its own clock.
    """
    levels = [1, 1]
    for byte in data:
        levels += [0, *(byte >> k & 1 for k in range(8)), 1]
    levels += [1] * 40

    def level(time: float) -> int:
        return levels[min(int(time * sent), len(levels) - 1)]

    time, read, end = 0.0, bytearray(), len(levels) / sent
    while time < end:
        if level(time):
            time += 0.1 / sent
            continue
        bits = [level(time + (k + 1.5) / received) for k in range(8)]
        read.append(sum(bit << k for k, bit in enumerate(bits)))
        time += 9.5 / received
        while time < end and not level(time):
            time += 0.1 / sent
    return bytes(read)


@pytest.mark.parametrize("baud", [9600, 19200, 38400, 57600, 230400, 250000])
def test_a_wrong_baud_rate_is_named(baud: int) -> None:
    port = GrblSimulatorPort(GrblSimulator())
    board = GrblBoard(OtherBaud(port, baud), MACHINE, port.clock, "/dev/ttyUSB0")
    with pytest.raises(BoardError) as caught:
        board.connect()
    assert "baud rate" in caught.value.diagnostic.message
    assert port.clock.now() < 2.7


def test_firmware_settings_and_offsets_are_read() -> None:
    info = BoardInfo("1.1h", Firmware.GRBL)
    info.take(
        [
            Feedback("OPT", "VZ,35,255"),
            Setting(130, "200.000"),
            Setting(131, "100"),
            Setting(20, "1"),
            Setting(23, "1"),
        ]
    )
    assert (info.options, info.blocks, info.rx_bytes) == ("VZ", 35, 255)
    # $23 says that X homes downwards, and the build puts the origin there.
    assert (info.travel(0), info.travel(1), info.travel(2)) == ((0.0, 200.0), (-100.0, 0.0), None)
    narrowed = info.narrowed(MACHINE)
    assert narrowed.axes["x"].travel == (0.0, 200.0)
    assert narrowed.axes["y"].travel == (-5.0, 0.0)
    assert narrowed.axes["z"].travel == MACHINE.axes["z"].travel


@pytest.mark.parametrize(
    ("options", "direction", "expected"),
    [("V", 0, (-198.0, -2.0)), ("VZ", 0, (-198.0, 0.0)), ("VZ", 1, (0.0, 198.0))],
)
def test_grblhal_keeps_the_pull_off_from_its_switches(
    options: str, direction: int, expected: tuple[float, float]
) -> None:
    """Its soft limits do so where hard limits are on (``$21``), on axes that home (``$44``..)."""
    settings = {20: "1", 21: "1", 23: str(direction), 27: "2.000", 44: "4", 45: "3"}
    settings |= {130: "200.000", 133: "360.000"}
    info = BoardInfo("1.1f", Firmware.HAL, options=options, settings=settings)
    assert info.limited_travel(0) == expected
    assert info.travel(3) is None
    assert BoardInfo("1.1h", Firmware.GRBL, settings=settings).limited_travel(0) == (-200.0, 0.0)


@pytest.mark.parametrize("told", ["V", "V,15", "V,15,x", "V,,", "", "V,15,3"])
def test_an_unreported_buffer_size_is_the_smallest(told: str) -> None:
    info = BoardInfo("1.1h", Firmware.GRBL)
    info.take([Feedback("OPT", told)])
    assert info.rx_bytes == 128


def test_the_larger_buffer_of_grblhal_is_used() -> None:
    simulator = GrblSimulator(GRBLHAL)
    board = started(simulator)
    assert board.info.kind is Firmware.HAL
    assert board.info.rx_bytes == 1024
    feed(board, PREAMBLE, *(f"G1 X{k % 3}.000 Y{k % 5}.000 F2000" for k in range(300)))
    board.finish()
    assert simulator.lost == 0


def test_the_clock_of_the_computer_is_the_default() -> None:
    device = Device(b"")
    assert isinstance(GrblBoard(device, MACHINE).link.clock, SystemClock)
    assert np.array_equal(ORIGIN, [0, 0, 0])


@pytest.mark.parametrize("profile", [GRBL, GRBLHAL], ids=["GRBL", "grblHAL"])
def test_an_open_safety_door_is_named(profile: FirmwareProfile) -> None:
    """A board whose door is open at its start reports Door, and reads no line."""
    environment = Environment(door_open=True)
    simulator = GrblSimulator(profile, environment=environment)
    with pytest.raises(BoardError) as caught:
        connected(simulator)
    found = caught.value.diagnostic
    assert found.code == "board-busy"
    assert "safety door is open" in found.message
    assert simulator.now < 3.0
    environment.door_open = False
    assert connected(simulator).status.state == "Idle"

"""The GRBL driver on the simulator: no byte is lost, and every way to end a run is reported."""

from __future__ import annotations

import random

import numpy as np
import pytest

from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.grbl.messages import Feedback, Setting
from cnc.boards.grbl.operator_requests import OperatorRequests
from cnc.boards.grbl.settings import BoardInfo
from cnc.boards.grbl.simulator.board import GrblSimulatorBoard
from cnc.boards.grbl.simulator.environment import Environment
from cnc.boards.grbl.simulator.faults import Unplug
from cnc.boards.grbl.simulator.firmware_profile import FLUIDNC, GRBLHAL
from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from cnc.boards.grbl.simulator.ports import GrblSimulatorPort
from cnc.boards.grbl.status import Status
from cnc.boards.port import SystemClock, port_lost
from cnc.boards.protocols import LineSink
from cnc.model.blocks import Dwell
from cnc.model.diagnostics import BoardError, UsageError
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine
from tests.support.boards.grbl_rig import MACHINE, connected, fails, started
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, LineBoardConformance, feed
from tests.support.boards.line_reader import lines_with_effects
from tests.support.soak import share


class TestGrblBoard(LineBoardConformance):
    def make(self) -> LineSink:
        return connected(GrblSimulator())


class TestGrblHal(LineBoardConformance):
    def make(self) -> LineSink:
        return connected(GrblSimulator(GRBLHAL))


class TestFluidNc(LineBoardConformance):
    def make(self) -> LineSink:
        return connected(GrblSimulator(FLUIDNC))


class TestGrblSimulator(LineBoardConformance):
    def make(self) -> LineSink:
        return GrblSimulatorBoard.from_machine(MACHINE)


def mixed(count: int, seed: int) -> list[str]:
    """Lines of all lengths: short and long moves, arcs, dwells, remarks, offset writes."""
    rng = random.Random(seed)
    lines = [PREAMBLE]
    for _ in range(count):
        kind = rng.random()
        x, y = rng.uniform(0, 9), rng.uniform(0, 9)
        if kind < 0.55:
            lines.append(f"G1X{x:.3f}Y{y:.3f}F{rng.randint(900, 2000)}")
        elif kind < 0.75:
            z, feed = -rng.random(), rng.randint(900, 2000)
            remark = "x" * rng.randint(0, 30)
            lines.append(f"G1 X{x:.4f} Y{y:.4f} Z{z:.4f} F{feed} ({remark})")
        elif kind < 0.9:
            lines.append(f"X{x:.1f}")
        elif kind < 0.99:
            lines.append(f"G4 P{rng.uniform(0, 0.02):.3f}")
        else:
            lines.append(f"G10 L2 P2 X{x:.3f}")
    return lines


def test_real_time_bursts_do_not_overflow_the_ring() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    rng = random.Random(5)
    for line in lines_with_effects(mixed(share(10_000, 700), 5)):
        board.send_line(line)
        if rng.random() < 0.02:
            board.link.write(b"?" * 200)
    board.finish()
    assert simulator.lost == 0
    assert simulator.fullest <= 127
    assert simulator.core.lines >= share(10_000, 700)


def test_check_mode_reaches_the_rate_of_the_wire() -> None:
    """Lines of 26 bytes at 115200 baud: the wire carries 443 a second."""
    simulator = GrblSimulator()
    board = connected(simulator)
    board.check_only = True
    board.connect_operator(Control(), lambda: None)
    board.start(ORIGIN)
    feed(board, PREAMBLE)
    board.execute(Dwell("p.nc", 1, 0.0), 0)
    count = 1500
    began = simulator.now
    for k in range(count):
        text = f"G1X{k % 10:.3f}Y{k % 7:.3f}F1000Z1.00000"[:25].ljust(25, "0")
        board.send_line(GcodeLine(text, k + 2))
    board.stream.drain()
    rate = count / (simulator.now - began)
    assert rate >= 0.95 * 115200 / 10 / 26


def test_offset_writes_during_motion_lose_no_bytes() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE)
    for k in range(40):
        feed(board, f"G1 X{k % 3} Y{k % 5} F1500", f"G10 L2 P3 X{k}.000", first=2 + 2 * k)
    board.finish()
    assert simulator.lost == 0
    assert board.confirmed_line == 81
    assert simulator.core.eeprom.systems["G56"][0] == 39.0


def test_a_stop_keeps_the_position_without_an_alarm() -> None:
    for seed in range(share(50, 6)):
        rng = random.Random(seed)
        simulator = GrblSimulator()
        control = Control()
        board = started(simulator, control)
        when = simulator.now + rng.uniform(0.2, 6.0)

        def stop_in_time(
            when: float = when, simulator: GrblSimulator = simulator, control: Control = control
        ) -> None:
            if simulator.now > when:
                control.stop()

        board.connect_operator(control, stop_in_time)
        feed(
            board,
            PREAMBLE,
            *(f"G1 X{rng.uniform(0, 9):.3f} Y{rng.uniform(0, 9):.3f} F1500" for _ in range(40)),
        )
        board.finish()
        assert control.stopped
        board.stop()
        assert simulator.core.state == "Idle"
        assert board.position == pytest.approx(simulator.position, abs=0.002)
        assert [event.value for event in simulator.events if event.kind == "alarm"] == []


def test_hold_and_resume_keep_all_motion() -> None:
    simulator = GrblSimulator()
    control = Control()
    seen: list[str] = []
    board = connected(simulator)
    held_at = simulator.now + 1.5

    def operate() -> None:
        state = board.status.state
        if not seen or seen[-1] != state:
            seen.append(state)
        if simulator.now > held_at and len(seen) < 3:
            control.hold()
        if state == "Hold" and simulator.now > held_at + 3.0:
            control.resume()

    board.connect_operator(control, operate)
    board.start(ORIGIN)
    feed(board, PREAMBLE, *(f"G1 X{k % 2 * 5} Y{k % 3 * 2} F1000" for k in range(12)))
    board.finish()
    assert seen[-4:] == ["Run", "Hold", "Run", "Idle"]
    assert board.position == pytest.approx((5.0, 4.0, 0.0), abs=0.002)


@pytest.mark.parametrize("percent", [10, 55, 87, 100, 123, 200])
def test_the_feed_override_is_reached_and_held(percent: int) -> None:
    simulator = GrblSimulator()
    control = Control(percent)
    board = started(simulator, control)
    assert simulator.core.planner.feed_override == percent
    control.override(100)
    feed(board, PREAMBLE, "G1 X9 F100")
    board.finish()
    assert simulator.core.planner.feed_override == 100


def test_an_unsupported_override_is_refused_before_motion() -> None:
    with pytest.raises(BoardError) as caught:
        started(GrblSimulator(), Control(5.0))
    assert caught.value.diagnostic.code == "override-refused"


def test_a_machine_that_was_moved_does_not_start() -> None:
    simulator = GrblSimulator()
    board = connected(simulator)
    simulator.write(b"G1 X1 F600\n")
    simulator.advance(simulator.now + 2.0)
    with pytest.raises(BoardError) as caught:
        board.start(ORIGIN)
    assert caught.value.diagnostic.code == "board-moved"


def said(state: str, override: int = 100, phase: int = -1) -> Status:
    return Status(state, phase, (0.0, 0.0, 0.0), None, (override, 100, 100))


def test_lost_requests_are_repeated() -> None:
    control = Control()
    requests = OperatorRequests(control)
    assert requests.commands(said("Run"), 0.0, 0.1) == b""
    control.hold()
    assert requests.commands(said("Run"), 0.1, 1.0) == b"!"
    assert requests.commands(said("Run"), 1.2, 1.3) == b""
    assert requests.commands(said("Run"), 1.6, 1.7) == b"!"
    assert requests.commands(said("Hold", phase=1), 1.8, 1.9) == b""
    control.resume()
    assert requests.commands(said("Hold", phase=0), 2.0, 2.1) == b"~"
    # a report that is older than the command, or as old, says nothing
    assert requests.commands(said("Hold", phase=0), 2.0, 3.0) == b""
    assert not control.held


def test_a_hold_at_the_machine_becomes_a_hold_of_the_operator() -> None:
    control = Control()
    requests = OperatorRequests(control)
    assert requests.commands(said("Hold", phase=0), 1.0, 1.1) == b""
    assert control.held
    assert requests.commands(said("Run"), 2.0, 2.1) == b""
    assert not control.held
    assert requests.commands(said("Door", phase=0), 3.0, 3.1) == b""
    assert control.held
    control.resume()
    assert requests.commands(said("Door", phase=0), 3.2, 3.3) == b"~"


@pytest.mark.parametrize(
    ("wanted", "now", "byte"),
    [
        (150, 100, b"\x91"),
        (50, 100, b"\x92"),
        (105, 100, b"\x93"),
        (95, 100, b"\x94"),
        (100, 100, b""),
    ],
)
def test_the_override_changes_in_steps_of_ten_and_one(wanted: int, now: int, byte: bytes) -> None:
    requests = OperatorRequests(Control(wanted))
    assert requests.commands(said("Run", now), 1.0, 1.1) == byte
    assert requests.commands(said("Run", now), 1.2, 1.3) == b""


def test_a_program_stop_waits_for_the_operator() -> None:
    simulator = GrblSimulator()
    control = Control()
    board = connected(simulator)
    waited: list[float] = []

    def operate() -> None:
        if control.held:
            waited.append(simulator.now)
            if len(waited) > 40:
                control.resume()

    board.connect_operator(control, operate)
    board.start(ORIGIN)
    feed(board, PREAMBLE, "G1 X1 F600", "M0", "G1 X2")
    board.finish()
    assert waited[-1] - waited[0] > 5.0
    assert board.position[0] == pytest.approx(2.0, abs=0.002)


def test_a_long_dwell_and_a_long_move_are_not_faults() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE, "G4 P45", "G1 X5 F2", "G4 P8", "G1 X6 F600")
    board.finish()
    assert simulator.now > 200.0
    assert board.position[0] == pytest.approx(6.0, abs=0.002)


def test_a_probe_returns_its_contact_and_a_miss_is_reported() -> None:
    simulator = GrblSimulator(environment=Environment(surface=((0.0, 0.0, 1.0), -4.0)))
    board = started(simulator)
    feed(board, PREAMBLE, "G38.2 Z-8 F120")
    answer = board.execute(Dwell("p.nc", 2, 0.0), 0)
    assert answer is not None
    assert answer == pytest.approx((1.0, 0.0, 0.0, -4.0), abs=0.01)
    feed(board, "G0 Z0", "G38.3 X5 F600", first=3)
    missed = board.execute(Dwell("p.nc", 4, 0.0), 0)
    assert missed is not None
    assert missed[0] == 0.0
    found = fails(board, "G38.2 X9 F600", first=5).diagnostic
    assert (found.code, found.line) == ("probe-no-contact", 5)


def test_a_soft_limit_alarm_is_reported() -> None:
    simulator = GrblSimulator(settings={20: 1, 22: 1, 130: 50, 131: 50, 132: 50})
    board = connected(simulator)
    board.link.ask("$X")
    board.connect_operator(Control(), lambda: None)
    board.start(ORIGIN)
    found = fails(board, PREAMBLE, "G1 X-60 F600").diagnostic
    assert (found.code, found.line) == ("board-alarm", 2)
    assert "ALARM:2" in found.message


def test_a_locked_board_is_not_unlocked() -> None:
    simulator = GrblSimulator(settings={22: 1})
    board = started(simulator)
    with pytest.raises(BoardError) as caught:
        feed(board, PREAMBLE, "G1 X1 F100")
    assert caught.value.diagnostic.code == "board-locked"
    assert "$H" in caught.value.diagnostic.hint


def test_long_homing_is_not_a_fault() -> None:
    simulator = GrblSimulator(settings={22: 1, 20: 1})
    board = started(simulator)
    feed(board, "$H", PREAMBLE)
    board.execute(Dwell("p.nc", 1, 0.0), 0)
    board.finish()
    # off the switches by the pull-off of $27
    assert board.position == pytest.approx((-1.0, -1.0, -1.0), abs=0.002)


def test_a_wrong_offset_is_found_before_motion() -> None:
    simulator = GrblSimulator()
    simulator.core.eeprom.systems["G54"] = (1.0, 2.0, 3.0)
    board = started(simulator)
    assert board.work_offset == (1.0, 2.0, 3.0)
    simulator.core.shift = (0.0, 0.5, 0.0)
    simulator.core.wco_counter = 0
    with pytest.raises(BoardError) as caught:
        feed(board, PREAMBLE, "G1 X1 F100")
    assert caught.value.diagnostic.code == "offset-differs"
    assert not simulator.moves


def test_a_line_that_is_too_long_is_not_sent() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    with pytest.raises(BoardError) as caught:
        feed(board, PREAMBLE, "G1 X1 F100 (" + "x" * 80 + ")")
    assert caught.value.diagnostic.code == "line-too-long"
    assert not simulator.moves


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
    assert device.time < (12.0 if b"Grbl" in greeting else 4.0)
    # Nothing but questions and a reset was sent.
    assert set(device.heard) <= set(b"?\x18\n")


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
    assert port.clock.now() < 4.0


def test_unplugging_reports_the_last_line_and_stops_the_run() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE, "G1 X2 F300", "G1 X4", "G1 X6", "G1 X8")
    pulled = simulator.now + 1.0
    simulator.inject(Unplug(), time=pulled)
    with pytest.raises(BoardError) as caught:
        board.finish()
    assert simulator.now - pulled < 1.0
    assert type(caught.value) is type(port_lost("", ""))
    assert caught.value.diagnostic.line == board.confirmed_line > 1
    with pytest.raises(BoardError):
        feed(board, "G1 X1")


def test_a_restart_of_the_board_is_reported() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE, "G1 X9 F300")
    board.stream.serve(1.0)
    simulator.power_up(0.3)
    with pytest.raises(BoardError) as caught:
        board.finish()
    assert caught.value.diagnostic.code in ("board-restarted", "off-path", "reply-lost")


def test_firmware_settings_and_offsets_are_read() -> None:
    info = BoardInfo("1.1h", hal=False)
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


@pytest.mark.parametrize("told", ["V", "V,15", "V,15,x", "V,,", "", "V,15,3"])
def test_an_unreported_buffer_size_is_the_smallest(told: str) -> None:
    info = BoardInfo("1.1h", hal=False)
    info.take([Feedback("OPT", told)])
    assert info.rx_bytes == 128


def test_the_larger_buffer_of_grblhal_is_used() -> None:
    simulator = GrblSimulator(GRBLHAL)
    board = started(simulator)
    assert board.info.hal
    assert board.info.rx_bytes == 1024
    feed(board, PREAMBLE, *(f"G1 X{k % 3}.000 Y{k % 5}.000 F2000" for k in range(300)))
    board.finish()
    assert simulator.lost == 0


def test_the_clock_of_the_computer_is_the_default() -> None:
    device = Device(b"")
    assert isinstance(GrblBoard(device, MACHINE).link.clock, SystemClock)
    assert np.array_equal(ORIGIN, [0, 0, 0])


def test_overrides_of_traverses_and_spindle_are_followed() -> None:
    simulator, control = GrblSimulator(), Control()
    control.override_rapids(25)
    control.override_spindle(137.0)
    board = started(simulator, control)
    core = simulator.core
    assert (core.planner.rapid_override, core.spindle_override) == (25, 137)
    feed(board, PREAMBLE, "M3 S100", "G0 X4", "G1 X8 F300")
    control.override_rapids(50)
    control.override_spindle(60.0)
    began = simulator.now
    while core.spindle_override != 60 and simulator.now - began < 15.0:
        board.stream.serve(0.05)
    assert (core.planner.rapid_override, core.spindle_override) == (50, 60)
    assert core.rpm == 60.0
    board.finish()


@pytest.mark.parametrize("percent", [0, 30, 99, 101])
def test_impossible_overrides_of_traverses_are_refused(percent: int) -> None:
    with pytest.raises(UsageError):
        Control().override_rapids(percent)


@pytest.mark.parametrize("percent", [0.0, 9.0, 201.0, float("nan")])
def test_impossible_overrides_of_the_spindle_are_refused(percent: float) -> None:
    with pytest.raises(UsageError):
        Control().override_spindle(percent)

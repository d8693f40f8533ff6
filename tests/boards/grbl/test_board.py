"""The GRBL driver on the simulator: no byte is lost, and every way to end a run is reported."""

from __future__ import annotations

import random

import pytest

from cnc.boards.port import port_lost
from cnc.boards.protocols import LineSink
from cnc.model.blocks import Dwell
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.model.streams import GcodeLine, PackedLines
from cnc.simulators.grbl.board import GrblSimulatorBoard
from cnc.simulators.grbl.firmware_profile import FLUIDNC, GRBLHAL
from cnc.simulators.grbl.grbl_simulator import Alarm, GrblSimulator, Unplug
from tests.support.boards.grbl_rig import MACHINE, connected, fails, started
from tests.support.boards.line_board_conformance import ORIGIN, PREAMBLE, LineBoardConformance, feed
from tests.support.boards.line_reader import lines_with_effects
from tests.support.boards.simulator_bench import material_below
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
    for line in lines_with_effects(mixed(share(10_000, 380), 5)):
        board.send_lines(PackedLines.of([line]))
        if rng.random() < 0.02:
            board.link.write(b"?" * 200)
    board.finish()
    assert simulator.lost == 0
    assert simulator.fullest <= 127
    assert simulator.core.lines >= share(10_000, 380)


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
        board.send_lines(PackedLines.of([GcodeLine(text, k + 2)]))
    board.stream.drain()
    rate = count / (simulator.now - began)
    assert rate >= 0.95 * 115200 / 10 / 26


def test_a_second_run_counts_its_own_lines() -> None:
    """A console runs programs one after the other on the same connection."""
    board = started(GrblSimulator())
    feed(board, PREAMBLE, "G1 X1 F1500", first=80)
    board.finish()
    assert board.confirmed_line == 81
    board.connect_operator(Control(), lambda: None)
    board.start(ORIGIN)
    assert board.confirmed_line == 0
    feed(board, PREAMBLE, "G1 X2 F1500")
    board.finish()
    assert board.confirmed_line == 2


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


def test_a_machine_that_was_moved_does_not_start() -> None:
    simulator = GrblSimulator()
    board = connected(simulator)
    simulator.write(b"G1 X1 F600\n")
    simulator.advance(simulator.now + 2.0)
    with pytest.raises(BoardError) as caught:
        board.start(ORIGIN)
    assert caught.value.diagnostic.code == "board-moved"


def test_a_long_dwell_and_a_long_move_are_not_faults() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    feed(board, PREAMBLE, "G4 P45", "G1 X5 F2", "G4 P8", "G1 X6 F600")
    board.finish()
    assert simulator.now > 200.0
    assert board.position[0] == pytest.approx(6.0, abs=0.002)


def test_a_probe_returns_its_contact_and_a_miss_is_reported() -> None:
    simulator = GrblSimulator(environment=material_below(-4.0))
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


def test_a_limit_switch_is_reported_with_the_line_of_the_motion() -> None:
    simulator = GrblSimulator()
    board = started(simulator)
    simulator.inject(Alarm(1), time=simulator.now + 2.7)
    # The board has accepted all lines by then.
    found = fails(board, PREAMBLE, "G1 X3 F500", "G1 X20", "G1 X21", "G1 X22", "G1 X23").diagnostic
    assert 15.0 < simulator.position[0] < 20.0
    assert (found.code, found.line) == ("board-alarm", 3)


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

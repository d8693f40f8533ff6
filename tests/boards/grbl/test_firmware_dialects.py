"""What grblHAL and FluidNC say that GRBL does not: locks, measured speeds, modes unasked, texts.

Sources: protocol.c, report.c and machine_limits.c of grblHAL's core; Protocol.cpp, Channel.cpp and
Error.cpp of FluidNC.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from cnc.boards.grbl.messages import Firmware
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from cnc.session.homing import home_by_board
from cnc.simulators.grbl.firmware_profile import (
    FLUIDNC,
    GRBL,
    GRBLHAL,
    GRBLHAL_AS_GRBL,
    FirmwareProfile,
)
from cnc.simulators.grbl.grbl_simulator import Drop, GrblSimulator
from cnc.simulators.grbl.workpiece import Environment
from tests.support.boards.grbl_rig import ROUTER, connected, fails, outcome, started
from tests.support.boards.line_board_conformance import PREAMBLE
from tests.support.boards.simulator_bench import HOMING, Bench

LOCKED = HOMING | {22: 7.0}
"""grblHAL is locked until it has homed (bit 2 of ``$22``)."""
MUST_HOME = [(GRBLHAL, LOCKED), (GRBLHAL_AS_GRBL, LOCKED), (FLUIDNC, HOMING)]
WITHOUT_PRINTABLE = replace(
    GRBLHAL,
    build_lines=tuple(line.replace("RT+", "RT-") for line in GRBLHAL.build_lines),
)
MOVES = tuple(f"G1 X{k % 7} Y{k % 5} F{600 + 60 * (k % 9)} S{100 * (k % 4 + 1)}" for k in range(80))


@pytest.mark.parametrize(("profile", "settings"), MUST_HOME)
def test_a_board_that_must_home_is_connected_and_homed(
    profile: FirmwareProfile, settings: dict[int, float]
) -> None:
    """It raises an alarm each time that it starts (ALARM:11, ALARM:14), and still answers."""
    bench = Bench(profile, settings)
    assert f"ALARM:{profile.lock_alarm}" in bench.welcome
    board = connected(bench.simulator)
    assert board.status.locked
    assert not board.position_lost
    home_by_board(board, (), Control())
    assert board.status.state == "Idle"
    assert bench.simulator.core.homed


def test_grblhal_is_not_unlocked_before_it_has_homed() -> None:
    bench = Bench(GRBLHAL, LOCKED)
    assert bench.reply("$X") == "error:46"
    assert bench.reply("$H", 60.0) == "ok"
    assert not any("ALARM" in line for line in bench.send(b"\x18"))
    assert bench.reply("$X") == "ok"


def test_a_pressed_emergency_stop_is_named() -> None:
    """grblHAL greets, raises ALARM:10, and ignores each reset."""
    board = GrblSimulator(GRBLHAL, environment=Environment(stop_pressed=True))
    for _ in range(2):
        with pytest.raises(BoardError) as caught:
            connected(board)
        assert caught.value.diagnostic.code == "board-alarm"
        assert "emergency stop is pressed" in caught.value.diagnostic.message
        assert board.now < 10.0
    board.core.environment.stop_pressed = False
    board.advance(board.now + 1.0)
    board.read()
    assert not connected(board).status.pins


def test_grblhal_that_may_work_unhomed_is_not_locked() -> None:
    assert Bench(GRBLHAL, HOMING).status()["state"] == "Idle"


def test_the_measured_speed_of_the_spindle_is_no_damage() -> None:
    """A report then has three numbers: ``FS:600,1000,998``."""
    simulator = GrblSimulator(replace(GRBLHAL, measured_speed=True), settings=ROUTER)
    board = started(simulator)
    assert outcome(board, [PREAMBLE, "M3 S700", *MOVES]) is None
    assert board.status.speed is not None
    assert "FS:0,0,0" in Bench(replace(GRBLHAL, measured_speed=True)).send("?", 0.1)[0]


@pytest.mark.parametrize("profile", [GRBLHAL, GRBLHAL_AS_GRBL])
def test_modes_that_grblhal_reports_unasked_are_no_lost_line(profile: FirmwareProfile) -> None:
    """Bit 9 of ``$10``: ``[GC:`` follows each status report if the modes have changed."""
    simulator = GrblSimulator(profile, settings=ROUTER | {10: 513.0})
    board = started(simulator)
    assert (board.info.kind, board.info.letters) == (Firmware.HAL, "XYZ")
    assert outcome(board, [PREAMBLE, *MOVES]) is None
    assert simulator.core.pushed_modes


def test_another_firmware_with_such_a_build_stays_grbl() -> None:
    """It refuses ``$I+``."""
    board = started(GrblSimulator(replace(GRBL, version="1.1f.20191224"), settings=ROUTER))
    assert board.info.kind is Firmware.GRBL
    assert outcome(board, [PREAMBLE, *MOVES]) is None


@pytest.mark.parametrize("profile", [GRBLHAL, FLUIDNC])
def test_a_lost_line_end_is_found_without_the_order_of_modes(profile: FirmwareProfile) -> None:
    simulator = GrblSimulator(profile, settings=ROUTER)
    board = started(simulator)
    simulator.inject(Drop(12), line=40)
    assert outcome(board, [PREAMBLE, *MOVES]) is not None


def test_commands_above_ascii_where_printable_ones_are_not_heard_everywhere() -> None:
    """RT-: ``?`` during a ``$`` command would be the begin of the next line."""
    bench = Bench(WITHOUT_PRINTABLE, HOMING)
    bench.send("$H\n", 0.5)
    bench.send("??", 60.0)
    assert bench.reply("G1 X1 F100") == "error:1"
    bench = Bench(WITHOUT_PRINTABLE, HOMING | ROUTER)
    board = started(bench.simulator)
    assert outcome(board, ["$H", PREAMBLE, "G53 G0 X-20 Y-20 Z-20"]) is None
    board.stop()
    assert bench.simulator.core.state == "Idle"


@pytest.mark.parametrize("axes", ["XYZ", "XYZA"])
def test_fluidnc_may_report_inches(axes: str) -> None:
    """``report_inches: true`` has no number; the feed of ``$G`` stays in mm."""
    simulator = GrblSimulator(FLUIDNC.with_axes(axes), settings=ROUTER | {13: 1.0})
    board = started(simulator)
    assert outcome(board, [PREAMBLE, *MOVES, "G1 X7.5 Y3 F600"]) is None
    assert board.position == pytest.approx(simulator.position[:3], abs=0.003)
    assert board.position[0] == pytest.approx(7.5, abs=0.01)


def test_an_error_of_fluidnc_may_be_a_text() -> None:
    """``verbose_errors: true`` in config.yaml."""
    simulator = GrblSimulator(replace(FLUIDNC, error_texts=True), settings=ROUTER)
    board = started(simulator)
    fault = fails(board, PREAMBLE, "G1 X1 F600", "G999", "G1 X2").diagnostic
    assert (fault.code, fault.line) == ("board-error", 3)
    assert "Unsupported GCode command" in fault.message

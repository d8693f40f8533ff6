"""The Klipper driver on the simulated board, in virtual time: conformance, programs, holds."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, run
from cnc.boards.klipper.driver import Klipper
from cnc.boards.klipper.protocol import Message
from cnc.boards.protocols import PulseSink
from cnc.machine.load import load_machine
from cnc.model.diagnostics import BoardError
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.board_conformance import AXES, MIN_PULSE_NS, PulseBoardConformance
from tests.support.boards.klipper_rig import (
    AVR,
    LONG_PULSE,
    MCUS,
    SHORT_PULSE,
    board,
    check_pulses,
    check_queues,
    event_ticks,
    machine,
    pins,
    place,
    played,
    steps_of,
    with_board,
)
from tests.support.boards.stepper_rig import chunks, eased
from tests.support.paths import PROGRAMS
from tests.support.programs.tool_parts import file_of, in_parts
from tests.support.soak import share


class TestConformance(PulseBoardConformance):
    plays_at_once = False

    def make(self, folder: Path) -> PulseSink:
        known = machine()
        known = known.model_copy(
            update={"board": known.board.model_copy(update={"max_step_rate": 1e9 / MIN_PULSE_NS})}
        )
        assert len(known.axes) == AXES
        port = KlipperSimulatorPort(simulator_for(known))
        return Klipper(port, known, "the simulator", clock=port)


SMALL = """G21 G90 G64 P0.01
M3 S500
G1 X3 Y2 Z-0.5 F1500
G3 X1 Y4 R2.5
G4 P0.1
M8
G0 Z1
G1 X0 Y0.3 F1200
M2
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    (tmp_path / "small.ngc").write_text(SMALL)
    return tmp_path / "small.ngc"


def tolerance_us(mcu: str) -> float:
    """Tolerance of the encoder, a tick, and the time of the other motors' steps."""
    return 5.0 + (40.0 if mcu in AVR else 1.5)


@pytest.mark.parametrize("mcu", share(MCUS, MCUS[::2]))
def test_pins_make_the_planned_steps(small: Path, tmp_path: Path, mcu: str) -> None:
    known = machine(mcu)
    report, simulator = played(small, tmp_path, known)
    assert report.ok, report.faults
    check_pulses(known, simulator, tmp_path, tolerance_us(mcu))
    check_queues(known, simulator, tmp_path)
    assert simulator.reason == ""


SENSING = ("turned-thread.nc", "probing.nc")
"""Programs that need a spindle sensor or a contact."""
SHIPPED = sorted(path.name for path in PROGRAMS.glob("*.nc") if path.name not in SENSING)
TOO_FAST_FOR_AVR = {
    LONG_PULSE: {
        "bezier.nc": 9,
        "compensation.nc": 9,
        "drilling.nc tool 1": 6,
        "drilling.nc tool 2": 6,
        "drilling.nc tool 3": 6,
        "drilling.nc tool 4": 6,
        "engraving.nc": 10,
        "fanuc-nurbs.nc": 9,
        "finishing.nc": 10,
        "ngc-nurbs.nc": 9,
        "pocket.nc": 9,
        "siemens-bspline.nc": 8,
        "thread-mill.nc": 10,
        "trident-as-printed.nc": 5,
        "trident.nc": 6,
    },
    SHORT_PULSE: {
        "bezier.nc": 23,
        "fanuc-nurbs.nc": 30,
        "finishing.nc": 11,
        "ngc-nurbs.nc": 12,
        "pocket.nc": 10,
        "siemens-bspline.nc": 11,
        "thread-mill.nc": 13,
        "trident-as-printed.nc": 5,
    },
}
"""Programs that an AVR cannot play with a pulse, and the first line that is too fast.

Klipper's firmware shuts down at lines 9 and 6 of compensation.nc and trident.nc with long pulses.
"""


CHIPS = [("atmega328p", SHORT_PULSE), *((mcu, LONG_PULSE) for mcu in MCUS)]
FEW = [
    ("trident.nc", "atmega328p", LONG_PULSE),
    ("trident.nc", "atmega328p", SHORT_PULSE),
    ("trident.nc", "stm32f446", LONG_PULSE),
    ("ngc-nurbs.nc", "atmega328p", LONG_PULSE),
]


@pytest.mark.soak
@pytest.mark.parametrize(
    ("name", "mcu", "pulse"),
    share([(name, *chip) for name in in_parts(SHIPPED) for chip in CHIPS], FEW),
)
def test_shipped_programs(name: str, mcu: str, pulse: float, tmp_path: Path) -> None:
    known = with_board(load_machine("default"), mcu)
    known = known.model_copy(update={"board": known.board.model_copy(update={"step_pulse": pulse})})
    report, simulator = played(file_of(name, tmp_path), tmp_path, known)
    too_fast = TOO_FAST_FOR_AVR[pulse] if mcu in AVR else {}
    if name in too_fast:
        found = [(fault.diagnostic.code, fault.diagnostic.line) for fault in report.faults]
        assert found == [("board-step-rate", too_fast[name])]
        assert not any(place(known, simulator))
        return
    assert report.ok, report.faults
    check_pulses(known, simulator, tmp_path, tolerance_us(mcu))
    check_queues(known, simulator, tmp_path)


def test_several_motors_of_an_axis(small: Path, tmp_path: Path) -> None:
    known = machine()
    y = pins(known).y
    assert y is not None
    both = y.model_copy(update={"step": (*y.step, "gpio25"), "direction": (*y.direction, "gpio26")})
    known = machine(y=both)
    report, simulator = played(small, tmp_path, known)
    assert report.ok
    first, second = (steps_of(known, simulator, "y", motor) for motor in range(2))
    np.testing.assert_array_equal(first[1], second[1])
    assert np.abs(first[0] - second[0]).max() <= 2 * event_ticks(simulator)


def test_dense_programs_are_refused_before_motion(tmp_path: Path) -> None:
    """Without a tolerance, nearly every step needs an entry of the queue of its own."""
    (tmp_path / "dense.ngc").write_text("G21 G90\nG1 X1 F60\nG1 X20 Y13.1 Z-7.3 F1500\nM2\n")
    known = machine("atmega328p", tolerance_us=0.0)
    report, simulator = played(tmp_path / "dense.ngc", tmp_path, known)
    assert [fault.diagnostic.code for fault in report.faults] == ["board-too-dense"]
    assert report.faults[0].diagnostic.line == 3
    assert place(known, simulator) == [0, 0, 0]


def test_other_algorithms_are_replaced_with_a_note(small: Path, tmp_path: Path) -> None:
    known = machine()
    report, simulator = played(small, tmp_path, known, algorithm="half-step")
    assert report.ok
    assert "algorithm-not-used" in [each.code for each in report.warnings]
    check_pulses(known, simulator, tmp_path, tolerance_us("rp2040"))


@pytest.mark.parametrize("moment", np.linspace(0.1, 0.45, share(20, 1)).tolist())
def test_hold_and_resume_change_no_step(small: Path, tmp_path: Path, moment: float) -> None:
    known = machine()
    _, reference = played(small, tmp_path, known)
    control, rests = Control(), []
    with board(known) as (driver, simulator):

        def on_sent(sent: object) -> None:
            sender = driver._sender
            if not rests and sender.running and sender.played_ns * 1e-9 > moment:
                control.hold()
            if getattr(sent, "held", False):
                rests.append(place(known, simulator))
                control.resume()

        report = run(
            small, known, board=driver, control=control, callbacks=Callbacks(on_sent=on_sent)
        )
    assert report.ok, report.faults
    assert rests
    assert any(rests[0])
    for letter in known.axes:
        np.testing.assert_array_equal(
            steps_of(known, simulator, letter)[1], steps_of(known, reference, letter)[1]
        )


def test_second_program_begins_where_the_first_ended(small: Path, tmp_path: Path) -> None:
    known = machine()
    (tmp_path / "next.ngc").write_text("G21 G90\nG0 X0 Y0 Z0\nM2\n")
    with board(known) as (driver, simulator):
        for program in (small, tmp_path / "next.ngc"):
            assert run(program, known, board=driver).ok
    assert place(known, simulator) == [0, 0, 0]


def test_long_pauses_get_a_new_reference_clock(tmp_path: Path) -> None:
    """Timers compare by 2**31 ticks: 12 s at 180 MHz."""
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X1 F600\nG4 P30\nG1 X2 Y1\nM2\n")
    known = machine("stm32f446")
    report, simulator = played(tmp_path / "p.ngc", tmp_path, known)
    assert report.ok, report.faults
    check_pulses(known, simulator, tmp_path, tolerance_us("stm32f446"))


def test_clock_wraps_during_the_motion(small: Path, tmp_path: Path) -> None:
    known = machine()
    simulator = simulator_for(known)
    simulator._start_clock = 2**32 - simulator.firmware.frequency // 2
    report, _ = played(small, tmp_path, known, simulator)
    assert report.ok, report.faults
    check_pulses(known, simulator, tmp_path, tolerance_us("rp2040"))


@pytest.mark.parametrize("drift", share([-3e-4, 3e-4], [3e-4]))
def test_drift_of_the_clock(small: Path, tmp_path: Path, drift: float) -> None:
    """The board's clock keeps the time of the motion."""
    known = machine()
    simulator = simulator_for(known)
    simulator.frequency = simulator.firmware.frequency * (1 + drift)
    report, _ = played(small, tmp_path, known, simulator)
    assert report.ok, report.faults
    check_pulses(known, simulator, tmp_path, tolerance_us("rp2040"))


@pytest.mark.parametrize("mcu", ["atmega328p", "rp2040"])
@pytest.mark.parametrize("rate", [1 / 3, 2 / 3, 0.8, 1.25, 1.5])
def test_clock_of_another_rate_is_refused(
    small: Path, tmp_path: Path, mcu: str, rate: float
) -> None:
    """Firmware for another crystal: all speeds would be wrong, and the queue would overflow."""
    known = machine(mcu)
    simulator = simulator_for(known)
    simulator.frequency = simulator.firmware.frequency * rate
    with pytest.raises(BoardError, match="board-clock") as caught:
        played(small, tmp_path, known, simulator)
    told = re.search(r"runs at about ([0-9.]+) MHz", str(caught.value))
    assert told and float(told[1]) == pytest.approx(simulator.frequency * 1e-6, rel=0.1)
    assert not simulator.edges_of
    assert simulator.reason == ""


@pytest.mark.parametrize(
    ("mcu", "drift"),
    [
        ("rp2040", 0.03),
        *share([("atmega328p", -0.08), ("atmega328p", 0.03), ("rp2040", -0.08)], []),
    ],
)
def test_clock_without_a_crystal_is_followed_and_told(
    small: Path, tmp_path: Path, mcu: str, drift: float
) -> None:
    known = machine(mcu)
    simulator = simulator_for(known)
    simulator.frequency = simulator.firmware.frequency * (1 + drift)
    report, _ = played(small, tmp_path, known, simulator)
    assert report.ok, report.faults
    [told] = [each for each in report.warnings if each.code == "board-clock-drift"]
    assert f"{100 * abs(drift):.1f} % too {'fast' if drift > 0 else 'slow'}" in told.message
    check_pulses(known, simulator, tmp_path, tolerance_us(mcu))


def test_clock_of_a_board_with_a_crystal_is_not_told(small: Path, tmp_path: Path) -> None:
    known = machine()
    report, _ = played(small, tmp_path, known, simulator_for(known))
    assert not [each for each in report.warnings if each.code == "board-clock-drift"]


def test_report_from_before_the_end_is_no_alarm(small: Path, tmp_path: Path) -> None:
    """A periodic report of the trigger may cross with the command that ends the watch."""
    known = machine()
    simulator = simulator_for(known)
    commands = simulator._commands
    end = commands._trsync_trigger

    def crossed(message: Message) -> None:
        commands._report(simulator.triggers[0], simulator.clock)
        end(message)

    commands._trsync_trigger = crossed  # type: ignore[method-assign]
    report, _ = played(small, tmp_path, known, simulator)
    assert report.ok, report.faults


@pytest.mark.parametrize(
    "watched", [(True, True, True), (True, False, True), (False, False, False)]
)
def test_no_two_switches_are_sampled_at_the_same_time(watched: tuple[bool, ...]) -> None:
    """A step of an AVR waits for the sample that is due; four samples would take it 50 us."""
    known = machine("atmega328p")
    with board(known) as (driver, simulator):
        driver.prepare_next_start(watched=watched, known=[True] * 3)
        driver.start(np.zeros(3, np.int64))
        time_ns, step = eased(200, 100_000)
        for part in chunks(time_ns, step, 100):
            driver.send(part)
        driver._supervisor.sender.flush()
        driver._supervisor.pump(0.05)
        armed = [switch for switch in simulator.switches if switch.armed]
        rest = armed[0].rest_ticks
        phases = sorted((switch.next_clock - armed[0].next_clock) % rest for switch in armed)
        driver.finish()
    assert len(armed) == 1 + sum(watched)
    gaps = np.diff([*phases, rest])
    assert gaps.max() - gaps.min() <= 1

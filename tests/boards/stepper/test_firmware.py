"""The firmware under a reviewer's eyes: its size, its other builds, its switches, and what it does
with what should not come.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from cnc.api import Callbacks, Outputs, run
from cnc.boards.stepper.driver import Stepper
from cnc.boards.stepper.frames import frame
from cnc.boards.stepper.protocol import Kind
from cnc.machine.models import Machine
from cnc.model.blocks import Spindle
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from tests.support.boards.stepper_host import (
    ALARM,
    BAD_STREAM,
    EMERGENCY_STOP,
    END_OF_STREAM,
    IDLE,
    LIMIT,
    RUNNING,
    SILENCE,
    STOPPED_BY_HOST,
    TOUCHED,
    UNDERRUN,
    Host,
    arm,
    outputs,
    straight,
)
from tests.support.boards.stepper_rig import (
    CLOSE_US,
    board,
    chunks,
    eased,
    line,
    machine,
    off_plan_us,
    stands_at,
    wander,
)
from tests.support.boards.stepper_simulator import (
    DIRECTION_PINS,
    FREQUENCY,
    STEP_PINS,
    Simulator,
    SimulatorPort,
    built,
)
from tests.support.session.runs import run_with
from tests.support.soak import share

STACK = 256
"""Bytes of the stack that nothing has touched, at least."""
RAM = 2048
BUILDS = [(3, 250_000), (4, 1_000_000), (4, 500_000)]
LIMIT_X, PROBE_PIN, ENABLE_PIN, SPINDLE_PIN, EMERGENCY_STOP_PIN, HOLD_PIN, RESUME_PIN = (
    9,
    19,
    8,
    11,
    14,
    15,
    16,
)


def with_axes(axes: int, **board_changes: object) -> Machine:
    """The shipped machine, with a fourth axis, or another board."""
    known = machine()
    letters = dict(zip("xyza", [*known.axes.values(), known.axes["x"]][:axes], strict=False))
    return known.model_copy(
        update={"axes": letters, "board": known.board.model_copy(update=board_changes)}
    )


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    made = Simulator()
    yield made
    assert made.lost == 0
    assert made.worst_fill <= 2
    assert made.stack_left > STACK
    made.close()


@pytest.fixture
def host(simulator: Simulator) -> Host:
    """A host that has told the board how it is built, and where it stands."""
    made = Host(simulator)
    made.hear()
    assert made.configure()
    assert made.stand_at(100, -200, 300)
    return made


def send_all(
    driver: Stepper,
    time_ns: NDArray[np.int64],
    step: NDArray[np.int8],
    after: Callable[[int], None],
) -> None:
    """Send rows to their end; ``after`` is told how many have been sent."""
    for part in chunks(time_ns, step, 100):
        driver.send(part)
        after(int(part.line[-1]))
    driver.finish()


# ----------------------------------------------------------------------------------------------------------------------
# builds

EVERY_BUILD = [(axes, baud) for axes in (1, 2, 3, 4) for baud in (250_000, 500_000, 1_000_000)]


@pytest.mark.parametrize(("axes", "baud"), share(EVERY_BUILD, [(3, 1_000_000), *BUILDS]))
def test_all_builds_fit_the_chip(axes: int, baud: int) -> None:
    made = subprocess.run(
        ["avr-size", built(axes, baud) / "stepper.elf"], capture_output=True, text=True, check=True
    )
    text, data, bss = (int(word) for word in made.stdout.splitlines()[1].split()[:3])
    assert text + data < 8 * 1024
    assert data + bss <= 1536, "1.6 kB, and not just so"


def test_inexact_baud_rate_is_refused() -> None:
    command = [
        "make",
        "-C",
        str(built().parents[1] / "firmware"),
        f"BUILD={built().parent / 'wrong'}",
        "BAUD=115200",
        "all",
    ]
    made = subprocess.run(command, capture_output=True, text=True, check=False)
    assert made.returncode != 0
    assert "BAUD is" in made.stderr


@pytest.mark.parametrize(("axes", "baud"), share(EVERY_BUILD[6:], BUILDS))
def test_all_builds_play_as_planned(axes: int, baud: int) -> None:
    """Moves without any order, then from rest to rest at a speed that 250 000 baud can feed."""
    simulator = Simulator(axes, baud)
    port = SimulatorPort(simulator)
    wild_ns, wild = wander(5, 400, 250_000)
    fast_ns, fast = eased(1_500, 40_000)
    time_ns = np.concatenate((wild_ns, fast_ns + wild_ns[-1] + 200_000))
    step = np.concatenate((wild, fast))
    if axes == 4:
        step = np.hstack((step, -np.roll(step[:, :1], 1)))
    with board(simulator, port, with_axes(axes)) as driver:
        driver.start(np.zeros(axes, np.int64))
        for part in chunks(time_ns, step):
            driver.send(part)
        driver.finish()
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step)
    assert off_plan_us(cycles, time_ns) <= CLOSE_US
    assert simulator.lost == 0
    assert simulator.stack_left > STACK
    simulator.close()


def test_a_program_of_four_axes(tmp_path: Path) -> None:
    (tmp_path / "four.ngc").write_text(
        "G21 G90 G64 P0.01\nG1 X5 Y3 A4 F2000\nG2 X8 Y0 I0 J-3 A-1\nG0 X0 Y0 Z1 A0.5\nM2\n"
    )
    simulator = Simulator(4, 500_000)
    port = SimulatorPort(simulator)
    known = with_axes(4)
    driver = Stepper(port, known, "the simulator", clock=port)
    report = run_with(
        tmp_path / "four.ngc",
        known,
        board=driver,
        outputs=Outputs(pulses=str(tmp_path / "pulses.npz")),
    )
    driver.close()
    assert report.ok, report.faults
    with np.load(tmp_path / "pulses.npz") as pulses:
        cycles, made = simulator.moves()
        np.testing.assert_array_equal(made, pulses["step"])
        assert off_plan_us(cycles, pulses["time_ns"]) <= CLOSE_US
    assert stands_at(made) == [0, 0, 400, 200]
    simulator.close()


# ----------------------------------------------------------------------------------------------------------------------
# pulses


@pytest.mark.parametrize(("axes", "pulse_us", "setup_us"), [(3, 5, 5), (3, 20, 12), (4, 3, 25)])
def test_pulse_length_and_direction_setup(axes: int, pulse_us: int, setup_us: int) -> None:
    """From the first move on, with turns at every chance, and moves that come sooner than they can
    be made.
    """
    simulator = Simulator(axes)
    known = with_axes(axes, step_pulse=pulse_us * 1e-6, direction_setup=setup_us * 1e-6)
    least_ns = max(18_000, (pulse_us + max(pulse_us, setup_us) + 4) * 1000)
    time_ns, step = wander(11, 600, least_ns)
    if axes == 4:
        step = np.hstack((step, -np.roll(step[:, :1], 1)))
    time_ns[100:400:7] = time_ns[99:399:7] + 6_000
    time_ns, alone = np.maximum.accumulate(time_ns), np.arange(100, 400, 7)
    step[alone], step[alone - 1] = np.eye(axes, dtype=np.int8)[0], -np.eye(axes, dtype=np.int8)[1]
    keep = ~np.isin(np.arange(600), np.concatenate((alone + 1, alone - 2)))
    with board(simulator, SimulatorPort(simulator), known) as driver:
        driver.start(np.zeros(axes, np.int64))
        for part in chunks(time_ns[keep], step[keep]):
            driver.send(part)
        driver.finish()
    np.testing.assert_array_equal(simulator.moves()[1], step[keep])
    edges = simulator.edges()
    for axis in range(axes):
        own = edges[edges["pin"] == STEP_PINS[axis]]
        rises, falls = (own["cycle"][own["level"] == level].astype(np.int64) for level in (1, 0))
        falls = falls[falls > rises[0]]
        assert len(falls) == len(rises)
        assert (falls - rises).min() >= pulse_us * 16
        assert (falls - rises).max() <= pulse_us * 16 + 8 + 100, (
            "a tick, and the longest that another interrupt takes"
        )
        assert (rises[1:] - falls[:-1]).min() >= pulse_us * 16 - 8
        turns = edges["cycle"][edges["pin"] == DIRECTION_PINS[axis]].astype(np.int64)
        after = np.searchsorted(rises, turns)
        assert (
            rises[after[after < len(rises)]] - turns[after < len(rises)]
        ).min() >= setup_us * 16 - 8
    simulator.close()


@pytest.mark.parametrize(("pulse_us", "setup_us"), [(20, 20), (60, 60), (10, 30)])
def test_closest_steps_of_long_pulses_are_on_time(
    simulator: Simulator, pulse_us: int, setup_us: int
) -> None:
    known = with_axes(3, step_pulse=pulse_us * 1e-6, direction_setup=setup_us * 1e-6)
    slow = {
        letter: axis.model_copy(update={"max_velocity": 5.0}) for letter, axis in known.axes.items()
    }
    time_ns, step = line(1_000, (pulse_us + max(pulse_us, setup_us) + 4) * 1_000)
    with board(simulator, known=known.model_copy(update={"axes": slow})) as driver:
        driver.start(np.zeros(3, np.int64))
        send_all(driver, time_ns, step, lambda sent: None)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step)
    assert off_plan_us(cycles, time_ns) <= CLOSE_US


class Noise(SimulatorPort):
    """Spikes on the switches' wires, at any moment: shorter than a switch is looked at, but
    often.
    """

    def __init__(self, simulator: Simulator, seed: int, pause: float) -> None:
        super().__init__(simulator)
        self.chance = np.random.default_rng(seed)
        self.pause = pause
        self.quiet_run = simulator.run
        self.on = False
        self.next = 0.0
        simulator.run = self.noisy_run  # type: ignore[method-assign]

    def noisy_run(self, seconds: float, *, or_byte: bool = False) -> None:
        until = self.board.now + seconds
        while self.on and self.board.now < until:
            if self.board.now >= self.next:
                pin = int(self.chance.choice((9, 10, 12, 14)))
                self.board.set_pin(pin, 0)
                self.quiet_run(float(self.chance.uniform(0.1e-6, 1.5e-6)))
                self.board.set_pin(pin, 1)
                self.next = self.board.now + float(self.chance.uniform(5e-6, self.pause))
            stop = min(self.next, until)
            self.quiet_run(max(stop - self.board.now, 2 / FREQUENCY), or_byte=or_byte)
            if self.board.now < stop:
                return  # for a byte
        if not self.on:
            self.quiet_run(seconds, or_byte=or_byte)


@pytest.mark.parametrize("pause", [1e-3, 60e-6])
def test_noise_on_switches_loses_no_step(simulator: Simulator, pause: float) -> None:
    """An interrupt that looks at the inputs must not keep the ends of pulses waiting until the next
    ones are due.

    Thirty thousand spikes a second leave the board no time for all of it: then it may come to rest.
    """
    fault = ""
    time_ns, step = line(share(20_000, 3_000), 18_000)
    port = Noise(simulator, 1, pause)
    with board(simulator, port) as driver:
        driver.start(np.zeros(3, np.int64))
        port.on = True
        try:
            send_all(driver, time_ns, step, lambda sent: None)
        except BoardError as error:
            fault = error.diagnostic.code
        port.on = False
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step[: len(made)])
    assert fault == "" or (fault == "board-underrun" and pause < 1e-3)
    if not fault:
        assert len(made) == len(step)
        assert off_plan_us(cycles, time_ns) <= CLOSE_US


# --------------------------------------------------------------------------------------------------------------------
# switches


@pytest.mark.parametrize(("pin", "within"), [(EMERGENCY_STOP_PIN, 200e-6), (LIMIT_X, 100e-6)])
@pytest.mark.parametrize("seed", range(share(40, 3)))
def test_switch_ends_the_motion_under_load(pin: int, within: float, seed: int) -> None:
    """At full speed, at any cycle, while bytes come as fast as the line has them, and statuses go
    out.
    """
    simulator = Simulator()
    host = Host(simulator)
    host.hear()
    assert host.configure()
    assert host.stand_at(0, 0, 0)
    host.stream(b"".join(straight(250, 36, 7) for _ in range(60)), 8_000)
    assert host.request(Kind.RUN)
    moment = np.random.default_rng(seed).uniform(0.02, 0.06)
    began = simulator.now
    pressed = 0
    while simulator.now < began + 0.1:
        if simulator.on_its_way < 40:
            simulator.send(frame(Kind.ASK, 0) * 6)
        host.hear(
            1e-4
            if pressed or simulator.now + 1e-4 < began + moment
            else max(began + moment - simulator.now, 1e-6)
        )
        if not pressed and simulator.now >= began + moment:
            pressed = simulator.cycle
            simulator.set_pin(pin, 0)
    cycles, made = simulator.moves()
    assert cycles[0] < pressed
    assert cycles[-1] - pressed <= within * FREQUENCY
    said = host.ask()
    assert said.alarm == (EMERGENCY_STOP if pin == EMERGENCY_STOP_PIN else LIMIT)
    assert list(said.position[:3]) == stands_at(made)
    simulator.close()


@pytest.mark.parametrize(("pin", "within"), [(EMERGENCY_STOP_PIN, 200e-6), (LIMIT_X, 100e-6)])
@pytest.mark.parametrize("seed", share(list(range(40)), [2, 9, 10]))
def test_bouncing_contact_ends_the_motion_as_fast(pin: int, within: float, seed: int) -> None:
    """A change that comes while the board looks at the one before is not forgotten."""
    simulator = Simulator()
    host = Host(simulator)
    host.hear()
    assert host.configure()
    assert host.stand_at(0, 0, 0)
    host.stream(b"".join(straight(250, 40, 7) for _ in range(40)), 8_000)
    assert host.request(Kind.RUN)
    chance = np.random.default_rng(seed)
    host.hear(0.02 + chance.uniform(0, 1e-3))
    for _ in range(chance.integers(1, 6)):
        simulator.set_pin(pin, 0)
        simulator.run(chance.uniform(1e-6, 12e-6))
        simulator.set_pin(pin, 1)
        simulator.run(chance.uniform(1e-6, 30e-6))
    simulator.set_pin(pin, 0)
    closed = simulator.cycle
    host.hear(0.003)
    cycles, made = simulator.moves()
    assert cycles[-1] - closed <= within * FREQUENCY
    assert list(host.ask().position[:3]) == stands_at(made)
    simulator.close()


NORMALLY_CLOSED = {
    "limits": (9, 10, 12),
    "probe": (19,),
    "emergency-stop": (14,),
    "hold": (15,),
    "resume": (16,),
}


@pytest.mark.parametrize(
    ("name", "pin", "code"),
    [
        ("limits", 10, "board-limit"),
        ("emergency-stop", 14, "board-emergency-stop"),
        ("limits", 12, "board-limit"),
    ],
)
def test_broken_wire_stops_the_machine(
    simulator: Simulator, name: str, pin: int, code: str
) -> None:
    """Normally closed, the switch holds its input low; broken, the pull-up makes it high."""
    for each in NORMALLY_CLOSED[name]:
        simulator.set_pin(each, 0)
    time_ns, step = eased(3_000, 50_000)
    with board(simulator, known=with_axes(3, normally_closed=(name,))) as driver:
        driver.start(np.zeros(3, np.int64))
        with pytest.raises(BoardError) as caught:
            send_all(driver, time_ns, step, lambda sent: simulator.set_pin(pin, int(sent > 1500)))
        assert caught.value.diagnostic.code == code
        made = simulator.moves()[1]
        np.testing.assert_array_equal(made, step[: len(made)])
        assert 0 < len(made) < len(step)
        assert driver.position_steps.tolist() == stands_at(made)
    with (
        pytest.raises(BoardError) as again,
        board(simulator, known=with_axes(3, normally_closed=(name,))) as driver,
    ):
        driver.start(np.zeros(3, np.int64))
    assert again.value.diagnostic.code == code


def test_machine_file_sets_the_level_of_switches(simulator: Simulator) -> None:
    """Told wrongly, every switch is pressed; told otherwise, the alarm that this made is gone."""
    names = tuple(NORMALLY_CLOSED)
    with (
        pytest.raises(BoardError) as caught,
        board(simulator, known=with_axes(3, normally_closed=names)),
    ):
        """Never here."""
    assert caught.value.diagnostic.code == "board-emergency-stop"
    for pins in NORMALLY_CLOSED.values():
        for pin in pins:
            simulator.set_pin(pin, 0)
    simulator.run(0.05)
    with board(simulator, known=with_axes(3, normally_closed=names)) as driver:
        assert driver._supervisor.ask().inputs == 0


@pytest.mark.parametrize("inverted", [False, True])
def test_machine_file_sets_the_level_of_the_enable_pin(
    simulator: Simulator, inverted: bool
) -> None:
    """From the start of a program on, alarms included; configured again, they stay as they are."""
    known = with_axes(3, invert_enable=inverted)
    simulator.run(0.01)
    assert simulator.level(ENABLE_PIN) == 1
    with board(simulator, known=known) as driver:
        assert simulator.level(ENABLE_PIN) == (not inverted)
        driver.start(np.zeros(3, np.int64))
        driver._supervisor.rest(0)
        assert simulator.level(ENABLE_PIN) == inverted
        simulator.set_pin(EMERGENCY_STOP_PIN, 0)
        simulator.run(0.01)
        assert simulator.level(ENABLE_PIN) == inverted
        simulator.set_pin(EMERGENCY_STOP_PIN, 1)
    with board(simulator, known=known):
        assert simulator.level(ENABLE_PIN) == inverted


# ---------------------------------------------------------------------------------------------------------------------
# buttons


PROGRAM = "G21 G90\nG1 X20 Y10 F2000\nM2\n"


def wait(simulator: Simulator, driver: Stepper, seconds: float) -> None:
    until = simulator.now + seconds
    while simulator.now < until:
        driver._supervisor.pump(0.002)


def test_buttons_hold_and_resume(simulator: Simulator, tmp_path: Path) -> None:
    (tmp_path / "p.ngc").write_text(PROGRAM)
    port = SimulatorPort(simulator)
    driver = Stepper(port, machine(), "the simulator", clock=port)
    control, rests, held_at = Control(), [], []

    def on_sent(sent: object) -> None:
        if not held_at and simulator.now > 0.25:
            held_at.append(simulator.cycle)
            simulator.set_pin(HOLD_PIN, 0)
        if getattr(sent, "held", False):
            simulator.set_pin(HOLD_PIN, 1)
            wait(simulator, driver, 0.1)
            rests.append(int(simulator.moves()[0][-1]))
            assert control.held, "the button that is let go changes nothing"
            simulator.set_pin(RESUME_PIN, 0)
            wait(simulator, driver, 0.02)
            simulator.set_pin(RESUME_PIN, 1)
            assert not control.held

    report = run(
        tmp_path / "p.ngc",
        machine(),
        board=driver,
        control=control,
        callbacks=Callbacks(on_sent=on_sent),
    )
    driver.close()
    assert report.ok, report.faults
    cycles, made = simulator.moves()
    assert stands_at(made) == [8_000, 4_000, 0]
    [rest] = rests
    assert np.diff(cycles)[np.searchsorted(cycles, rest)] > 0.1 * FREQUENCY, "it stood still"
    # 33 mm/s: 0.083 + 0.027 s to brake
    assert (rest - held_at[0]) / FREQUENCY < 0.15 + 0.025 + 0.11


def test_bouncing_button_counts_once(host: Host) -> None:
    before = host.ask()
    for pin in (HOLD_PIN, RESUME_PIN):
        for bounce in (1e-4, 2e-4, 3e-4, 0.02):
            host.simulator.set_pin(pin, 0)
            host.hear(bounce)
            host.simulator.set_pin(pin, 1)
            host.hear(1e-4)
        host.simulator.set_pin(pin, 0)
        host.hear(0.02)
        host.simulator.set_pin(pin, 1)
    unasked = [each for each in host.frames if each[0] == Kind.STATUS]
    after = host.ask()
    assert (after.holds - before.holds, after.resumes - before.resumes) == (1, 1)
    assert len(unasked) >= 2, "it says so by itself"


@pytest.mark.parametrize(
    ("pin", "code"), [(EMERGENCY_STOP_PIN, "board-emergency-stop"), (None, "board-silent")]
)
def test_fault_during_a_hold_ends_the_run(tmp_path: Path, pin: int | None, code: str) -> None:
    """Nobody waits for a resume that can't help; time is the link's thread's, as with a real
    port.
    """
    (tmp_path / "p.ngc").write_text(PROGRAM)
    simulator = Simulator()
    port = SimulatorPort(simulator)
    driver = Stepper(port, machine(), "the simulator", clock=port, background=True)
    control = Control()
    quiet_read = port.read

    def read(timeout: float) -> bytes:
        """A look at the port takes a little, even where it waits for nothing."""
        return quiet_read(max(timeout, 0.02))

    def on_sent(sent: object) -> None:
        if simulator.now > 0.25:
            control.hold()
        if getattr(sent, "held", False):
            with driver._lock:
                port.read = read  # type: ignore[method-assign]
                if pin is None:
                    port.write = lambda data: None  # type: ignore[method-assign]
                else:
                    simulator.set_pin(pin, 0)

    report = run(
        tmp_path / "p.ngc",
        machine(),
        board=driver,
        control=control,
        callbacks=Callbacks(on_sent=on_sent),
    )
    driver.close()
    assert [fault.diagnostic.code for fault in report.faults] == [code]
    assert report.exit_code == 3
    simulator.close()


# ----------------------------------------------------------------------------------------------------------------------
# frames


def test_invalid_configurations_are_refused(host: Host) -> None:
    for wrong in ({"pulse": 0}, {"pulse": 121}, {"setup": 121}, {"ramp": 0}):
        assert not host.configure(**wrong)
    assert not host.request(Kind.CONFIGURE, bytes(5))
    assert not host.request(Kind.SET_POSITION, bytes(15))
    assert not host.request(Kind.RUN), "nothing has come"
    assert host.configure(pulse=120, setup=120, ramp=255)
    assert host.ask().state == IDLE


def test_request_is_carried_out_once(host: Host) -> None:
    host.stream(straight(10, 200) + END_OF_STREAM, 1)
    run_again = frame(Kind.RUN, 77)
    host.said(run_again)
    host.hear(0.05)
    host.stream(straight(10, 200) + END_OF_STREAM, 1)
    host.said(run_again)
    host.hear(0.05)
    assert len(host.simulator.moves()[0]) == 10
    host.said(frame(Kind.RUN, 78))
    host.hear(0.05)
    assert len(host.simulator.moves()[0]) == 20
    assert host.ask().position[:3] == (120, -200, 300)


def test_damaged_frame_has_no_effect(host: Host) -> None:
    """Every single bit of a request and of a piece of the stream: whole for COBS or not, its CRC is
    wrong.
    """
    before = host.ask()
    for whole in (
        frame(Kind.SET_POSITION, 99, bytes(range(16))),
        frame(Kind.DATA, 0, b"\1\x80" + straight(9, 300)),
    ):
        for bit in range(share(8 * (len(whole) - 1), 40)):
            wrong = bytearray(whole)
            wrong[bit // 8] ^= 1 << bit % 8
            host.simulator.send(bytes(wrong) + b"\0")
            host.hear(0.001)
    after = host.ask()
    assert after == before
    assert any(each[0] == Kind.NAK and each[1] == 0 for each in host.frames)


def test_reset_discards_earlier_moves(host: Host) -> None:
    """Whatever numbers the frames under way have: they may be those that the board wants after its
    reset.
    """
    host.stream(b"".join(straight(100, 200) for _ in range(10)), 100, end=False)
    assert host.request(Kind.RUN)
    host.hear(0.02)
    assert host.ask().state == RUNNING
    host.simulator.reset()
    host.hear(0.01)
    made = len(host.simulator.moves()[0])
    host.sequence = 0
    host.stream(straight(100, 200) + END_OF_STREAM, 10)
    assert not host.request(Kind.RUN)
    said = host.ask()
    assert (said.known, said.state, said.position) == (0, IDLE, (0, 0, 0, 0))
    host.hear(0.5)
    assert len(host.simulator.moves()[0]) == made


def test_driver_detects_a_reset(simulator: Simulator) -> None:
    time_ns, step = line(6_000, 50_000)
    reset_at = 0.0

    def reset(sent: int) -> None:
        nonlocal reset_at
        if not reset_at and simulator.now > 0.2:
            simulator.reset()
            reset_at = simulator.now

    with board(simulator) as driver:
        driver.start(np.zeros(3, np.int64))
        with pytest.raises(BoardError) as caught:
            send_all(driver, time_ns, step, reset)
        assert caught.value.diagnostic.code == "board-reset"
        assert "position is lost" in caught.value.diagnostic.message
        assert simulator.now - reset_at < 1.0
        assert driver.known_steps == (None,) * 3
        _, made = simulator.moves()
        places = made.cumsum(axis=0, dtype=np.int64)
        behind = (
            len(places) - 1 - int(np.flatnonzero((places == driver.position_steps).all(axis=1))[0])
        )
        assert behind < 0.03 / 50e-6, "where it was when it last told"
        simulator.run(0.5)
        assert len(simulator.moves()[0]) == len(made)


def test_driver_detects_a_slow_reset(simulator: Simulator) -> None:
    """A bootloader says nothing for a second or more."""
    time_ns, step = line(6_000, 50_000)
    port = SimulatorPort(simulator)
    reset_at = 0.0

    def reset(sent: int) -> None:
        nonlocal reset_at
        if not reset_at and simulator.now > 0.2:
            simulator.reset()
            reset_at = simulator.now
            port.write = lambda data: None  # type: ignore[method-assign]

    with board(simulator, port) as driver:
        driver.start(np.zeros(3, np.int64))
        with pytest.raises(BoardError) as caught:
            send_all(driver, time_ns, step, reset)
        assert caught.value.diagnostic.code == "board-silent"
        assert "ome the machine" in caught.value.diagnostic.hint
        assert simulator.now - reset_at < 1.0
        assert driver.known_steps == (None,) * 3


@pytest.mark.parametrize(
    "wrong",
    [
        bytes((0, 0)) + bytes(6),
        bytes((10, 0)) + bytes(5) + b"\x70" + bytes(24),
        bytes((10, 0)) + bytes(5) + b"\x11" + bytes(8),
        bytes((200, 0x18)) + bytes(30),
    ],
    ids=["no slots", "three phases", "a phase of an axis that always steps", "a long command"],
)
def test_invalid_stream_is_an_alarm(host: Host, wrong: bytes) -> None:
    host.stream(straight(20, 400) + wrong + END_OF_STREAM, 10)
    assert host.request(Kind.RUN)
    host.hear(0.1)
    said = host.ask()
    assert (said.state, said.alarm) == (ALARM, BAD_STREAM)
    assert list(said.position[:3]) == [100 + len(host.simulator.moves()[0]), -200, 300]


# ----------------------------------------------------------------------------------------------------------------------
# alarms


@pytest.mark.parametrize("how", [0, 1])
def test_stop_at_rest_is_an_alarm_and_ends_the_spindle(host: Host, how: int) -> None:
    host.stream(outputs(0b01011, 128) + END_OF_STREAM, 0)
    assert host.request(Kind.RUN)
    host.hear(0.01)
    assert host.simulator.level(17)
    assert host.request(Kind.STOP, bytes((how,)))
    said = host.ask()
    assert (said.state, said.alarm) == (ALARM, STOPPED_BY_HOST)
    host.hear(0.01)
    assert not host.simulator.level(17)
    assert not host.simulator.level(ENABLE_PIN), "the drivers hold"


def test_stop_does_not_replace_an_alarm(host: Host) -> None:
    host.simulator.set_pin(EMERGENCY_STOP_PIN, 0)
    host.hear()
    assert host.request(Kind.STOP, b"\1")
    assert host.ask().alarm == EMERGENCY_STOP
    assert not host.request(Kind.CLEAR)
    host.simulator.set_pin(EMERGENCY_STOP_PIN, 1)
    assert host.request(Kind.CLEAR)
    assert host.ask().state == IDLE


@pytest.mark.parametrize("touch", [False, True])
def test_outputs_go_off_when_the_host_dies_at_rest(host: Host, touch: bool) -> None:
    """After a probe's touch, too."""
    host.stream(
        outputs(0b01001) + (arm(0x10, 0) + straight(200, 2_000) if touch else b"") + END_OF_STREAM,
        220,
    )
    assert host.request(Kind.RUN)
    host.hear(0.05)
    if touch:
        host.simulator.set_pin(PROBE_PIN, 0)
        host.hear()
    assert host.ask().state == (TOUCHED if touch else IDLE)
    assert host.simulator.level(17)
    host.hear(0.2)
    assert host.simulator.level(17)
    host.hear(0.06)
    assert not host.simulator.level(17)
    assert host.ask().alarm == SILENCE


@pytest.mark.parametrize("alarm", ["e-stop", "limit", "silence", "stream"])
def test_all_alarms_end_spindle_and_coolant_but_not_the_drivers(host: Host, alarm: str) -> None:
    host.stream(
        outputs(0b11011, 200) + b"".join(straight(100, 2_000) for _ in range(5)),
        500,
        end=alarm == "silence",
    )
    if alarm == "stream":
        host.stream(bytes((0, 0)) + bytes(6), 500)
    assert host.request(Kind.RUN)
    host.hear(0.05)
    levels = [host.simulator.level(pin) for pin in (ENABLE_PIN, 17, 18)]
    assert levels == [0, 1, 1]
    if alarm in ("e-stop", "limit"):
        host.simulator.set_pin(EMERGENCY_STOP_PIN if alarm == "e-stop" else LIMIT_X, 0)
        host.hear(0.002)
    else:
        for _ in range(30):
            host.hear(0.02)
            if alarm == "stream":
                host.ask()
    assert [host.simulator.level(pin) for pin in (ENABLE_PIN, 17, 18)] == [0, 0, 0]
    quiet = host.simulator.edges()
    host.hear(0.01)
    assert not (host.simulator.edges()[len(quiet) :]["pin"] == SPINDLE_PIN).any()


def test_alarm_at_rest_is_reported(simulator: Simulator) -> None:
    """The driver turns it off with an abort at once, not when the watchdog bites."""
    with board(simulator) as driver:
        driver.start(np.zeros(3, np.int64))
        driver.execute(Spindle("p.nc", 1, "cw", 500.0), 0)
        driver._supervisor.rest(1_000_000)
        driver.abort()
        edges = len(simulator.edges())
        simulator.run(0.01)
        assert not (simulator.edges()[edges:]["pin"] == SPINDLE_PIN).any()


@pytest.mark.parametrize("ms", share(list(range(20, 120, 5)), [37, 80]))
def test_slow_host_loses_no_step(host: Host, ms: int) -> None:
    """It asks, so it lives, but the stream ends without saying so: all axes come to rest together,
    and what was made is what is told.
    """
    moves = ms * 2_000 // 50
    both = b"".join(straight(min(200, moves - at), 50, 3, down=2) for at in range(0, moves, 200))
    host.stream(both, ms, end=False)
    assert host.request(Kind.RUN)
    while (said := host.ask()).state != ALARM:
        assert host.simulator.now < 1.0
    assert said.alarm == UNDERRUN
    cycles, made = host.simulator.moves()
    assert 0 < len(made) < moves
    assert list(said.position[:3]) == [100 + len(made), -200 - len(made), 300]
    # 40 000 steps a second before; at rest the last gaps are many times that, and none is shorter
    # than planned
    gaps = np.diff(cycles)
    assert gaps.min() >= 25e-6 * FREQUENCY - 80
    assert gaps[-3:].min() > 2 * 25e-6 * FREQUENCY


def test_silent_host_ends_the_motion_by_a_ramp(
    host: Host,
) -> None:
    """What is left of the speed at x of the ramp is 1 - x^2 (3 - 2 x), to one of its 32 steps; the
    fourth is the first that shows.
    """
    ramp, gap = 0.2, 100e-6
    assert host.configure(ramp=round(ramp * 1e3))
    host.stream(b"".join(straight(250, 200, 1) for _ in range(60)), 1_500)
    assert host.request(Kind.RUN)
    host.simulator.run(0.1)
    host.simulator.send(frame(Kind.ASK, 0))
    heard = host.simulator.now
    host.simulator.run(0.8)
    t = host.simulator.moves()[0] / FREQUENCY - heard
    gaps = np.diff(t)
    began = float(t[np.flatnonzero(gaps > 1.03 * gap)[0]])
    assert 0.25 <= began - 3 * ramp / 32 <= 0.265
    x = (t[:-1] + gaps / 2 - (began - 3 * ramp / 32)) / ramp
    slowing = (x > 0.05) & (x < 0.9)
    left = 1 - x**2 * (3 - 2 * x)
    assert np.abs(gap / gaps - left)[slowing].max() < 1.5 / 32 + 0.02
    assert t[-1] - began < ramp + 0.01
    said = host.ask()
    assert (said.state, said.alarm) == (ALARM, SILENCE)
    assert said.position[0] == 100 + len(t)

"""The stepper board's firmware in simavr with the real driver: its pins, move by move and cycle by
cycle.
"""

from __future__ import annotations

import numpy as np
import pytest

from cnc.boards.stepper.driver import Stepper
from cnc.model.blocks import Coolant, Dwell, Spindle
from cnc.model.diagnostics import BoardError
from tests.support.boards.segment_decoder import SegmentDecoder
from tests.support.boards.stepper_rig import (
    CLOSE_US,
    FAULTS,
    BadCable,
    assert_played,
    board,
    chunks,
    eased,
    line,
    machine,
    off_plan_us,
    stands_at,
    wander,
)
from tests.support.boards.stepper_simulator import FREQUENCY, Simulator, SimulatorPort
from tests.support.soak import share

LEAST_NS = 18_000
ORIGIN = np.zeros(3, np.int64)


def play(simulator: Simulator, time_ns, step) -> None:
    with board(simulator) as driver:
        driver.start(ORIGIN)
        for part in chunks(time_ns, step):
            driver.send(part)
        driver.finish()
        assert driver.position_steps.tolist() == stands_at(step)


def send_all(driver: Stepper, time_ns, step, between=lambda: None) -> None:
    for part in chunks(time_ns, step):
        driver.send(part)
        between()
    driver.finish()


@pytest.mark.parametrize("gap_ns", [LEAST_NS, 20_000, 100_000])
def test_straight_move_of_three_axes(simulator: Simulator, gap_ns: int) -> None:
    time_ns, step = line(min(12_000, 240_000_000 // gap_ns), gap_ns)
    play(simulator, time_ns, step)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step)
    assert off_plan_us(cycles, time_ns) <= CLOSE_US


@pytest.mark.parametrize("baud", share((1_000_000, 500_000), (500_000,)))
@pytest.mark.parametrize("shares", [(1.0, 1.0, 1.0), (1.0, -0.63, 0.277)])
def test_fifty_thousand_moves_per_second_with_reversals(
    baud: int, shares: tuple[float, ...]
) -> None:
    """In segments of 40 moves all axes step together, or one after the other."""
    simulator = Simulator(baud=baud)
    time_ns, step = line(10_000, 20_000, shares)
    step[(np.arange(len(step)) // 40) % 2 == 1] *= -1
    time_ns += 1_000_000
    play(simulator, time_ns, step)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step)
    assert off_plan_us(cycles, time_ns) <= CLOSE_US
    assert simulator.lost == 0
    simulator.close()


def test_from_rest_to_rest(simulator: Simulator) -> None:
    time_ns, step = eased(4_000, 25_000)
    play(simulator, time_ns, step)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step)
    assert off_plan_us(cycles, time_ns) <= CLOSE_US


@pytest.mark.parametrize("seed", range(share(40, 2)))
def test_random_moves(simulator: Simulator, seed: int) -> None:
    time_ns, step = wander(seed, 1_000, 60_000)
    play(simulator, time_ns, step)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step)
    assert off_plan_us(cycles, time_ns) <= CLOSE_US


def test_default_pulse_length_and_direction_setup(simulator: Simulator) -> None:
    time_ns, step = wander(7, 500, LEAST_NS)
    play(simulator, time_ns, step)
    edges = simulator.edges()
    for axis in range(3):
        own = edges[edges["pin"] == 2 + axis]
        own = own[1:] if len(own) % 2 else own
        rises, falls = (
            own["cycle"][own["level"] == 1].astype(np.int64),
            own["cycle"][own["level"] == 0].astype(np.int64),
        )
        assert (falls - rises).min() >= 5e-6 * FREQUENCY - 8
        turns = edges["cycle"][edges["pin"] == 5 + axis].astype(np.int64)
        after = np.searchsorted(rises, turns)
        ahead = rises[after[after < len(rises)]] - turns[after < len(rises)]
        assert ahead.min() >= 5e-6 * FREQUENCY - 8


def test_commands_are_on_time(simulator: Simulator) -> None:
    time_ns, step = line(100, 500_000)
    with board(simulator) as driver:
        driver.start(ORIGIN)
        driver.execute(Spindle("p.nc", 1, "cw", 500.0), 0)
        driver.execute(Dwell("p.nc", 2, 0.25), 0)
        for part in chunks(time_ns + 250_000_000, step):
            driver.send(part)
        end = int(time_ns[-1]) + 250_000_000
        driver.execute(Coolant("p.nc", 4, mist=False, flood=True), end)
        driver.execute(Dwell("p.nc", 5, 0.1), end)
        assert simulator.level(17) == 0
        driver.finish()
    edges = simulator.edges()
    began = edges["cycle"][(edges["pin"] == 8) & (edges["level"] == 0)][-1]
    cycles, made = simulator.moves()
    assert (cycles[0] - began) / FREQUENCY == pytest.approx(0.2505, abs=0.002)
    flood = edges[edges["pin"] == 17]
    on = flood["cycle"][flood["level"] == 1][-1]
    assert (on - cycles[-1]) / FREQUENCY == pytest.approx(0.0, abs=0.002)
    off = flood["cycle"][-1]
    assert flood["level"][-1] == 0
    assert (off - on) / FREQUENCY == pytest.approx(0.1, abs=0.002)
    np.testing.assert_array_equal(made, step)


# ----------------------------------------------------------------------
# faults


@pytest.mark.parametrize("chance", share([0.001, 0.01], [0.01]))
@pytest.mark.parametrize("faults", FAULTS[:: share(1, 2)])
@pytest.mark.parametrize("seed", range(share(50, 1)))
def test_bad_cable_loses_no_step(chance: float, faults: str, seed: int) -> None:
    simulator = Simulator()
    time_ns, step = eased(5_000, 60_000)
    fault = ""
    try:
        with board(simulator, BadCable(simulator, chance, seed, faults)) as driver:
            driver.start(ORIGIN)
            for part in chunks(time_ns, step):
                driver.send(part)
            driver.finish()
    except BoardError as error:
        fault = error.diagnostic.code
    simulator.run(0.6)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step[: len(made)])
    assert fault in ("", "board-underrun", "board-silence", "board-silent")
    if len(made):
        assert_played(cycles, time_ns)
        assert list(status(simulator).position[:3]) == stands_at(made)
    if not fault:
        assert len(made) == len(step)
        assert off_plan_us(cycles, time_ns) <= CLOSE_US
    simulator.close()


def status(simulator: Simulator):
    """Return the status of the board, as another host reads it."""
    from cnc.boards.stepper.protocol import Status, StepperLink

    link = StepperLink()
    simulator.received()
    found = None
    for _ in range(50):
        link.ask()
        simulator.send(b"\0" + link.outgoing(simulator.now))
        simulator.run(0.005)
        for event in link.receive(simulator.received(), simulator.now):
            found = event if isinstance(event, Status) else found
        if found is not None:
            return found
    raise AssertionError("no answer")


class Killed(Exception):
    """The host has ended."""


@pytest.mark.parametrize("moment", np.linspace(0.1, 0.6, share(50, 2)).tolist())
def test_dead_host_leaves_the_machine_on_its_path(simulator: Simulator, moment: float) -> None:
    time_ns, step = eased(6_000, 50_000)
    with board(simulator) as driver:
        driver.start(ORIGIN)
        port = driver._supervisor.connection.port
        until = simulator.now + moment * time_ns[-1] * 1e-9

        def write(data: bytes) -> None:
            if simulator.now > until:
                raise Killed
            simulator.send(data)

        port.write = write
        with pytest.raises(Killed):
            send_all(driver, time_ns, step)
        simulator.run(0.8)
        _, made = simulator.moves()
        np.testing.assert_array_equal(made, step[: len(made)])
        assert 0 < len(made) < len(step)
        said = status(simulator)
        assert said.state.name == "ALARM"
        assert said.alarm.name in ("UNDERRUN", "SILENCE")
        assert list(said.position[:3]) == stands_at(made)
        port.write = simulator.send


def test_ramp_is_smooth(simulator: Simulator) -> None:
    """The speed falls along the ramp, never steeper than the S-curve at its middle."""
    time_ns, step = line(8_000, 50_000, (1.0,) * 3)
    with board(simulator) as driver:
        driver.start(ORIGIN)
        for part in chunks(time_ns[:4_000], step[:4_000]):
            driver.send(part)
        driver._supervisor.halt()
        assert driver.position_steps.tolist() == stands_at(simulator.moves()[1])
    cycles, _ = simulator.moves()
    t = (cycles - cycles[0]) / FREQUENCY
    # the speed in every millisecond, of which 1 is the plan's
    speed = np.histogram(t, np.arange(0.0, t[-1], 1e-3))[0] * 50e-6 / 1e-3
    begin = np.flatnonzero(speed < 0.95)[0]
    assert (speed[2:begin] > 0.94).all()
    assert (np.diff(speed[begin:]) < 0.06).all()
    assert (np.diff(speed[begin - 2 :]) > -0.12).all(), (
        "steeper than the S is in 2.5 ms, the length of a step of the ramp"
    )
    assert 0.05 < t[-1] - begin * 1e-3 < 0.085


@pytest.mark.parametrize(
    ("pin", "code", "within"),
    [(14, "board-emergency-stop", 200e-6), (9, "board-limit", 100e-6), (12, "board-limit", 100e-6)],
)
def test_switch_ends_the_motion(simulator: Simulator, pin: int, code: str, within: float) -> None:
    time_ns, step = eased(6_000, 50_000)
    with board(simulator) as driver:
        driver.start(ORIGIN)
        pressed = None

        def press() -> None:
            nonlocal pressed
            if pressed is None and simulator.now > 0.2:
                simulator.set_pin(pin, 0)
                pressed = simulator.cycle

        with pytest.raises(BoardError) as caught:
            send_all(driver, time_ns, step, press)
        cycles, made = simulator.moves()
        assert caught.value.diagnostic.code == code
        assert cycles[-1] - pressed < within * FREQUENCY
        np.testing.assert_array_equal(made, step[: len(made)])
        assert driver.position_steps.tolist() == stands_at(made)
        assert caught.value.diagnostic.line == len(made)


@pytest.mark.parametrize("seed", range(share(20, 1)))
def test_moves_faster_than_the_line_end_in_a_ramp(simulator: Simulator, seed: int) -> None:
    """The stream needs more than a megabaud.

    No burst makes up for late moves: the board comes to rest and reports it.
    """
    chance = np.random.default_rng(seed)
    time_ns, step = wander(seed, 12_000, LEAST_NS)
    time_ns = np.cumsum(chance.integers(LEAST_NS, 26_000, len(time_ns)))
    with board(simulator) as driver:
        driver.start(ORIGIN)
        with pytest.raises(BoardError) as caught:
            send_all(driver, time_ns, step)
        assert caught.value.diagnostic.code == "board-underrun"
        simulator.run(0.5)
        cycles, made = simulator.moves()
        np.testing.assert_array_equal(made, step[: len(made)])
        assert driver.position_steps.tolist() == stands_at(made)
    assert_played(cycles, time_ns)


def test_spike_on_a_switch_does_not_end_the_motion(simulator: Simulator) -> None:
    time_ns, step = line(3_000, 50_000)
    with board(simulator) as driver:
        driver.start(ORIGIN)
        for part in chunks(time_ns, step, 100):
            driver.send(part)
            simulator.set_pin(9, 0)
            simulator.set_pin(9, 1)
        driver.finish()
    np.testing.assert_array_equal(simulator.moves()[1], step)


def test_spindle_stops_when_the_host_is_silent(simulator: Simulator) -> None:
    with board(simulator) as driver:
        driver.start(ORIGIN)
        driver.execute(Spindle("p.nc", 1, "cw", 500.0), 0)
        driver._supervisor.rest(1_000_000)
        simulator.run(0.2)
        assert status(simulator).alarm.name == "NONE"
        simulator.run(0.3)
        said = status(simulator)
        assert said.alarm.name == "SILENCE"


class LooseCable(SimulatorPort):
    """Carries no bytes in either direction during an interval."""

    def __init__(self, simulator: Simulator, pulled: float, put_back: float) -> None:
        super().__init__(simulator)
        self.pulled, self.put_back = pulled, put_back

    @property
    def off(self) -> bool:
        return self.pulled <= self.now() < self.put_back

    def read(self, timeout: float) -> bytes:
        data = super().read(
            min(timeout, max(self.pulled - self.now(), 0.001)) if not self.off else timeout
        )
        return b"" if self.off else data

    def write(self, data: bytes) -> None:
        if not self.off:
            super().write(data)


@pytest.mark.parametrize("seed", range(share(50, 1)))
def test_reconnected_cable(simulator: Simulator, seed: int) -> None:
    """An interruption of 10 ms to 5 s has no effect, or the error comes within a second, with the
    last line, and motion ends.
    """
    chance = np.random.default_rng(seed)
    time_ns, step = eased(6_000, 50_000)
    cable = LooseCable(simulator, 1e9, 0.0)
    fault = None
    driver = Stepper(cable, machine(), "the simulator", clock=cable)
    driver.start(ORIGIN)
    cable.pulled = simulator.now + float(chance.uniform(0.05, 0.5))
    cable.put_back = (
        cable.pulled + (0.01, 5.0, 0.1, float(10 ** chance.uniform(-2.0, 0.7)))[min(seed, 3)]
    )
    try:
        send_all(driver, time_ns, step)
    except BoardError as error:
        fault = error.diagnostic
        assert simulator.now - cable.pulled < 1.0
    simulator.run(0.5)
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(made, step[: len(made)])
    assert_played(cycles, time_ns)
    if fault is None:
        assert len(made) == len(step)
    else:
        assert len(made)
        simulator.run(max(cable.put_back - simulator.now, 0.0) + 1.0)
        assert len(simulator.moves()[1]) == len(made), "it goes on by itself"
        said = status(simulator)
        assert said.state.name == ("ALARM" if len(made) < len(step) else "IDLE"), (
            "all of it may have got through"
        )
        assert list(said.position[:3]) == stands_at(made)
        if fault.code == "board-silent":
            # the last that is known to have reached the board: of what came after it no answer came
            # back
            assert abs(time_ns[fault.line - 1] - time_ns[len(made) - 1]) < 150e6
        else:
            assert fault.line == len(made)
            assert driver.position_steps.tolist() == stands_at(made)
    driver.close()


def test_decoder_plays_the_bytes_sent(simulator: Simulator) -> None:
    """The Python decoder makes the moves of the pins from the stream that the board received."""
    time_ns, step = wander(3, 800, 40_000)
    with board(simulator) as driver:
        sent = bytearray()
        stream = driver._supervisor.connection.link.stream
        driver._supervisor.connection.link.stream = lambda data, *rest, **more: (
            sent.extend(data),
            stream(data, *rest, **more),
        )[1]
        driver.start(ORIGIN)
        for part in chunks(time_ns, step):
            driver.send(part)
        driver.finish()
    played = [
        np.concatenate(each) for each in zip(*SegmentDecoder(3).play(bytes(sent)), strict=True)
    ]
    cycles, made = simulator.moves()
    np.testing.assert_array_equal(played[1], made)
    assert off_plan_us(cycles, played[0]) <= 1.5

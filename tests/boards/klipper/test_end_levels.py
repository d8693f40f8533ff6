"""Simulated switches at the ends: samples that can see nothing new are skipped, with no effect."""

from __future__ import annotations

import random
from functools import partial

import pytest

from cnc.boards.klipper.protocol import Message
from cnc.simulators.klipper.klipper_simulator import Commands, KlipperSimulator
from cnc.simulators.klipper.objects import EndLevel
from tests.support.soak import share

MOTOR, SWITCH, TRIGGER = 0, 1, 2
STEP, DIRECTION, END = "gpio0", "gpio1", "gpio2"
REST, SAMPLE = 1800, 120


class Bench:
    """A board with a motor, a switch at its end, and a trigger that stops the motor."""

    def __init__(self, end: tuple[int, float], *, skipping: bool) -> None:
        self.board = KlipperSimulator()
        self._commands = Commands(self.board)
        self.do("allocate_oids", count=3)
        pins = {"step_pin": self.board.pin(STEP), "dir_pin": self.board.pin(DIRECTION)}
        self.do("config_stepper", oid=MOTOR, **pins, invert_step=0, step_pulse_ticks=24)
        self.do("config_endstop", oid=SWITCH, pin=self.board.pin(END), pull_up=1)
        self.do("config_trsync", oid=TRIGGER)
        self.do("finalize_config", crc=1)
        self.motor, self.switch = self.board.motors[0], self.board.switches[0]
        level = EndLevel(self.board.positions, self.motor.step_pin, end, 0)
        self.board.set_pin(END, level if skipping else partial(level))

    def do(self, name: str, **values: int) -> None:
        assert self._commands.carry_out(Message(name, values))

    def reset(self, clock: int) -> None:
        self.do("reset_step_clock", oid=MOTOR, clock=clock % 2**32)

    def arm(self, clock: int, wanted: int) -> None:
        self.do("trsync_start", oid=TRIGGER, report_clock=0, report_ticks=0, expire_reason=3)
        self.do("stepper_stop_on_trigger", oid=MOTOR, trsync_oid=TRIGGER)
        self.reset(clock)
        self._sample(wanted, clock=(clock + 50) % 2**32, sample_ticks=SAMPLE, sample_count=3)

    def disarm(self) -> None:
        self._sample(0, clock=0, sample_ticks=0, sample_count=0)

    def _sample(self, wanted: int, **times: int) -> None:
        trigger = {"trsync_oid": TRIGGER, "trigger_reason": 1}
        self.do("endstop_home", oid=SWITCH, rest_ticks=REST, pin_value=wanted, **times, **trigger)

    def step(self, interval: int, count: int = 1, add: int = 0) -> None:
        self.do("queue_step", oid=MOTOR, interval=interval, count=count, add=add)

    def wait(self, ticks: float) -> None:
        self.board.advance(self.board.now + ticks / self.board.frequency)


def fired(seed: int, *, skipping: bool) -> list[tuple[int, int]]:
    """Play random moves with an armed switch; return clock (0: never fired) and place each time."""
    draw = random.Random(seed)
    bench = Bench((draw.choice((1, -1)), draw.uniform(-40, 40)), skipping=skipping)
    board, motor, switch = bench.board, bench.motor, bench.switch
    stops: list[tuple[int, int]] = []
    for wanted in (0, 1, 0, 1, 0):
        bench.arm(board.clock + draw.randrange(100, 20_000), wanted)
        for _ in range(12):
            if not (motor.active or motor.needs_reset):
                bench.reset(board.clock - draw.randrange(200))
            bench.do("set_next_step_dir", oid=MOTOR, dir=draw.choice((0, 1)))
            interval, count = draw.randrange(200, 30_000), draw.randrange(1, 40)
            most = min(interval // 2 // count, 300)
            bench.step(interval, count, draw.randint(-most, most))
            bench.wait(draw.uniform(0.0, 120_000))
        while motor.active:
            bench.wait(draw.uniform(0.0, 120_000))
        bench.wait(2 * REST)
        stops.append((switch.next_clock if not switch.armed else 0, motor.position))
        bench.disarm()
    return stops


def test_a_new_reference_clock_may_bring_steps_earlier() -> None:
    bench = Bench((1, 8.5), skipping=True)
    bench.arm(bench.board.clock, 0)
    bench.do("set_next_step_dir", oid=MOTOR, dir=1)
    for _ in range(20):
        if not bench.motor.needs_reset:
            bench.reset(bench.board.clock - 29_000)
        bench.step(30_000)
        bench.wait(2 * REST)
    assert bench.motor.position in (9, 10)


@pytest.mark.parametrize("seed", share(range(300), range(6)))
def test_skipped_samples_change_nothing(seed: int) -> None:
    assert fired(seed, skipping=True) == fired(seed, skipping=False)


def test_the_switch_fires_at_all() -> None:
    found = [stop for seed in range(12) for stop in fired(seed, skipping=True)]
    assert 10 < sum(clock > 0 for clock, _ in found) < len(found)

"""Alarms of the firmware: causes, outputs, and a host that is slow or silent."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.boards.stepper.protocol import Kind, frame
from cnc.model.blocks import Spindle
from tests.support.boards.stepper_host import (
    ALARM,
    EMERGENCY_STOP,
    END_OF_STREAM,
    IDLE,
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
    EMERGENCY_STOP_PIN,
    ENABLE_PIN,
    LIMIT_X,
    PROBE_PIN,
    SPINDLE_PIN,
    board,
)
from tests.support.boards.stepper_simulator import (
    FREQUENCY,
    Simulator,
)
from tests.support.soak import share


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
    """This holds after the touch of a probe, too."""
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
    """An abort of the driver ends the spindle at once, long before the watchdog."""
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
    """The host asks for statuses, but the stream ends without its end flag.

    All axes come to rest together. The reported position counts all steps that were made.
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
    """At x of the ramp the speed is 1 - x^2 (3 - 2 x) of that before, in 32 steps.

    The fourth is the first that can be measured.
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

"""Switches and buttons at the firmware: limits, emergency stop, hold, resume, levels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, run
from cnc.boards.stepper.driver import Stepper
from cnc.boards.stepper.protocol import Kind, frame
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control
from tests.support.boards.stepper_host import (
    EMERGENCY_STOP,
    LIMIT,
    Host,
    straight,
)
from tests.support.boards.stepper_rig import (
    EMERGENCY_STOP_PIN,
    ENABLE_PIN,
    HOLD_PIN,
    LIMIT_X,
    RESUME_PIN,
    board,
    eased,
    machine,
    send_all,
    stands_at,
    with_axes,
)
from tests.support.boards.stepper_simulator import (
    FREQUENCY,
    Simulator,
    SimulatorPort,
)
from tests.support.soak import share


def moving(steps: int, ticks: int, segments: int) -> tuple[Simulator, Host]:
    """Return a board that moves all three axes in segments of so many steps and ticks a step."""
    simulator = Simulator()
    host = Host(simulator)
    host.hear()
    assert host.configure()
    assert host.stand_at(0, 0, 0)
    host.stream(b"".join(straight(steps, ticks, 7) for _ in range(segments)), 8_000)
    assert host.request(Kind.RUN)
    return simulator, host


@pytest.mark.parametrize(("pin", "within"), [(EMERGENCY_STOP_PIN, 200e-6), (LIMIT_X, 100e-6)])
@pytest.mark.parametrize("seed", range(share(40, 2)))
def test_switch_ends_the_motion_under_load(pin: int, within: float, seed: int) -> None:
    """The board runs at full speed, receives bytes at the full line rate, and sends statuses."""
    simulator, host = moving(250, 36, 60)
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
    """The board does not lose a change during the debounce of the change before."""
    simulator, host = moving(250, 40, 40)
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
    """A normally closed switch holds its input low.

    If the wire breaks, the pull-up makes it high.
    """
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
    """With the wrong level every switch counts as pressed. With the right level that alarm ends."""
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
    """The drivers stay enabled from the start of a program, through alarms and configurations."""
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
    """The run does not wait for a resume that cannot help.

    The thread of the link advances the time, as with a real port.
    """
    (tmp_path / "p.ngc").write_text(PROGRAM)
    simulator = Simulator()
    port = SimulatorPort(simulator)
    driver = Stepper(port, machine(), "the simulator", clock=port, background=True)
    control = Control()
    quiet_read = port.read

    def read(timeout: float) -> bytes:
        """Read the port; each call takes some time, even with a timeout of 0."""
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

"""Runs on the Klipper board that are held, overridden, interrupted, and continued at a line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, run
from cnc.session.run_pulses import Progress
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import simulator_for
from tests.support.boards.klipper_rig import (
    after,
    board,
    last_step,
    machine,
    pins,
    place,
    played,
    steps_of,
)
from tests.support.session.runs import run_with
from tests.support.soak import share

PROGRAM = (
    "G21 G90 G64\nM3 S500\nG0 Z3\nG1 Z-1 F600\n"
    + "".join(f"G1 X{k} Y{k % 3} F1200\n" for k in range(1, 13))
    + "G0 Z5\nM2\n"
)
"""Line k + 4 moves to X k."""
END = [12 * 400, 0, 5 * 400]


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "p.ngc").write_text(PROGRAM)
    return tmp_path / "p.ngc"


@pytest.fixture
def exact(tmp_path: Path) -> Path:
    """The program on the exact path. Corners within a tolerance depend on the feed."""
    (tmp_path / "exact.ngc").write_text(PROGRAM.replace("G64", "G61"))
    return tmp_path / "exact.ngc"


class Died(BaseException):
    """Stands for the death of the process."""


@pytest.mark.soak
@pytest.mark.parametrize("percent", share([30, 70, 140], [30]))
def test_override_changes_the_speed_and_no_step(exact: Path, tmp_path: Path, percent: int) -> None:
    known = machine()
    _, reference = played(exact, tmp_path, known)
    control, simulator = Control(), simulator_for(known)
    after(simulator, 0.4, lambda: control.override(percent))
    with board(known, simulator) as (driver, _):
        report = run(exact, known, board=driver, control=control)
    assert report.ok, report.faults
    for letter in known.axes:
        np.testing.assert_array_equal(
            steps_of(known, simulator, letter)[1], steps_of(known, reference, letter)[1]
        )
    slower, usual = (
        np.ptp(steps_of(known, each, "x")[0].astype(float)) for each in (simulator, reference)
    )
    assert (slower > 1.05 * usual) if percent < 100 else (slower < usual)


@pytest.mark.parametrize("seed", range(share(20, 1)))
def test_holds_and_overrides_at_any_moment(exact: Path, tmp_path: Path, seed: int) -> None:
    """The order of the steps of each axis stays, and they end where the program ends."""
    known, chance = machine(), np.random.default_rng(seed)
    _, reference = played(exact, tmp_path, known)
    control, rests = Control(), []
    with board(known) as (driver, simulator):

        def on_sent(sent: Progress) -> None:
            if sent.held:
                rests.append(place(known, simulator))
                control.resume()
            elif chance.random() < 0.02:
                control.hold()
            elif chance.random() < 0.05:
                control.override(float(chance.integers(20, 180)))

        callbacks = Callbacks(on_sent=on_sent)
        report = run(exact, known, board=driver, control=control, callbacks=callbacks)
    assert report.ok, report.faults
    assert rests
    for letter in known.axes:
        np.testing.assert_array_equal(
            steps_of(known, simulator, letter)[1], steps_of(known, reference, letter)[1]
        )


@pytest.mark.soak
@pytest.mark.parametrize("kind", share(["e-stop", "stopped", "cable", "died"], ["e-stop"]))
def test_an_interrupted_run_continues_at_its_checkpoint(program: Path, kind: str) -> None:
    known, control = machine(), Control()
    simulator = simulator_for(known)
    stop_pin = str(pins(known).emergency_stop).strip("^!")

    def on_sent(sent: Progress) -> None:
        if sent.position is None or sent.position[0] < 4.0:
            return
        if kind == "e-stop":
            simulator.set_pin(stop_pin, 0)
        elif kind == "stopped":
            control.stop()
        elif kind == "cable":
            simulator.cable.unplug()
        else:
            raise Died

    callbacks = Callbacks(on_sent=on_sent)
    with board(known, simulator) as (driver, _):
        if kind == "died":
            with pytest.raises(Died):
                run_with(program, known, board=driver, control=control, callbacks=callbacks)
        else:
            first = run_with(program, known, board=driver, control=control, callbacks=callbacks)
            assert first.exit_code == (0 if kind == "stopped" else 3)
    simulator.advance(simulator.now + 1.0)
    simulator.cable.plugged = True
    simulator.set_pin(stop_pin, 1)
    found = json.loads(Path(f"{program}.checkpoint").read_text())
    stands = place(known, simulator)[0] / 400
    assert 3.9 < stands < 12.0
    # The line that the machine has come to, or an earlier one: nothing is left out.
    assert (
        0
        <= int(np.ceil(stands - 1e-3)) - (found["line"] - 4)
        <= (1 if kind in ("e-stop", "stopped") else 4)
    )
    made = place(known, simulator)
    with board(known, simulator) as (driver, _):
        driver._position.set(driver._supervisor.read_positions(), np.array(made))
        driver._position.known[:] = True
        driver._sender.position = np.array(made)
        second = run_with(program, known, board=driver, from_line=found["line"])
    assert second.ok, second.faults
    assert place(known, simulator) == END
    assert not Path(f"{program}.checkpoint").exists()


@pytest.mark.soak
@pytest.mark.parametrize("line", share([6, 11], [11]))
def test_run_from_a_line_makes_the_same_end(program: Path, tmp_path: Path, line: int) -> None:
    report, simulator = played(program, tmp_path, machine(), from_line=line)
    assert report.ok, report.faults
    assert place(machine(), simulator) == END


def stands_still(simulator: KlipperSimulator, seconds: float) -> None:
    """Let this computer stand still: the board goes on, and nothing is sent to it."""
    advance = type(simulator).advance
    advance(simulator, simulator.now + seconds)


@pytest.mark.soak
@pytest.mark.parametrize("moment", share(np.linspace(0.3, 2.0, 12).tolist(), [0.7]))
@pytest.mark.parametrize("seconds", share([0.1, 0.2], [0.2]))
def test_short_standstill_of_the_computer_changes_nothing(
    program: Path, tmp_path: Path, seconds: float, moment: float
) -> None:
    known = machine()
    simulator = simulator_for(known)
    after(simulator, moment, lambda: stands_still(simulator, seconds))
    report, _ = played(program, tmp_path, known, simulator)
    assert report.ok, report.faults
    assert place(known, simulator) == END


@pytest.mark.parametrize("moment", share(np.linspace(0.3, 2.0, 12).tolist(), [0.7]))
@pytest.mark.parametrize("seconds", share([0.3, 0.6, 3.0], [3.0]))
def test_long_standstill_of_the_computer_is_reported(
    program: Path, tmp_path: Path, seconds: float, moment: float
) -> None:
    """A stopped process, or a collection of garbage. Nothing moves after it by itself."""
    known = machine()
    simulator = simulator_for(known)
    after(simulator, moment, lambda: stands_still(simulator, seconds))
    report, _ = played(program, tmp_path, known, simulator)
    [fault] = report.faults
    assert fault.diagnostic.code in ("board-underrun", "board-silence", "klipper-shutdown")
    made = place(known, simulator)
    at = report.end_position.values()
    assert [round(v * s) for v, s in zip(at, known.steps_per_mm, strict=True)] == made
    assert report.resume_line is not None
    begun = simulator.now
    simulator.advance(simulator.now + 2.0)
    assert last_step(simulator) < begun
    assert place(known, simulator) == made
    spindle = pins(known).spindle
    assert spindle is not None
    assert simulator.value(spindle.pin) == 0

"""All builds of the firmware: size, baud rates, numbers of axes."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs
from cnc.boards.stepper.driver import Stepper
from tests.support.boards.stepper_rig import (
    CLOSE_US,
    STACK,
    board,
    chunks,
    eased,
    off_plan_us,
    stands_at,
    wander,
    with_axes,
)
from tests.support.boards.stepper_simulator import (
    Simulator,
    SimulatorPort,
    built,
)
from tests.support.session.runs import run_with
from tests.support.soak import share

BUILDS = [(3, 250_000), (4, 1_000_000), (4, 500_000)]
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
    """Random moves, then a motion from rest to rest at a speed that 250 000 baud can carry."""
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

"""Kills of the program and pulled cables: the machine ends at rest, nothing resumes by itself."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.klipper.driver import Klipper
from cnc.boards.serial_port import identity
from cnc.machine.load import load_machine
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import KlipperSimulatorPort, PtyServer, simulator_for
from tests.support.boards.klipper_rig import board, machine, pins, place
from tests.support.paths import ROOT
from tests.support.session.runs import run_with
from tests.support.soak import share
from tests.support.waiting import HANG, wait_until

PROGRAM = "G21 G90\nM3 S500\n" + "G1 X8 Y5 F1500\nG3 X0 Y0 I-4 J-2.5\n" * 8 + "M2\n"
MOMENTS = np.random.default_rng(5).uniform(0.3, 4.0, share(50, 2)).tolist()
ATTEMPTS = 12
"""A busy computer may end a run with an underrun before it is killed; then the next kill comes in
half of the motion that this run made.
"""
IN_FLIGHT = 250
"""Steps that the commands on a full wire make, at most."""
COMMAND = [sys.executable, "-c", "from cnc.cli import main; main()"]


def made(simulator: KlipperSimulator) -> int:
    """Return the number of steps so far."""
    return sum(each.size for parts in list(simulator.edges_of.values()) for each in parts)


@pytest.mark.soak
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")
@pytest.mark.parametrize(
    "steps", np.random.default_rng(7).integers(50, 12_000, share(50, 1)).tolist()
)
def test_killed_command(steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = load_machine("klipper-uno")
    (tmp_path / "p.ngc").write_text(PROGRAM)
    simulator = simulator_for(known)
    spindle = pins(known).spindle
    assert spindle is not None
    environment = {
        **os.environ,
        "XDG_STATE_HOME": str(tmp_path / "state"),
        "PYTHONPATH": str(ROOT),
    }
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with PtyServer(simulator) as server:
        name = identity(server.name)
        options = ["--machine", "klipper-uno", "--port", server.name, "--quiet"]
        for _ in range(ATTEMPTS):
            process = subprocess.Popen(
                [*COMMAND, str(tmp_path / "p.ngc"), *options],
                env=environment,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            begun = made(simulator)
            try:
                wait_until(
                    lambda begun=begun, process=process, steps=steps: (  # type: ignore[misc]
                        made(simulator) >= begun + steps or process.poll() is not None
                    )
                )
            finally:
                process.kill()
                ended = process.wait(HANG)
            if ended == -signal.SIGKILL:
                break
            steps = max((made(simulator) - begun) // 2, 1)
        assert ended == -signal.SIGKILL
        killed = simulator.now
        wait_until(lambda: simulator.now > killed + 1.0)
        with server.lock:
            rested = place(known, simulator)
            assert simulator.value(spindle.pin) == 0
        wait_until(lambda: simulator.now > killed + 1.5)
        with server.lock:
            assert place(known, simulator) == rested
    assert made(simulator)
    port = KlipperSimulatorPort(simulator)
    again = Klipper(port, known, "again", clock=port, identity=name)
    assert again._position.counts(again._supervisor.read_positions()) == rested
    # A busy computer may have ended the motion on its path before.
    assert again.known_steps in ((None, None, None), tuple(rested))


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.skipif(not share(True, False), reason="it takes seconds of real time")
@pytest.mark.parametrize("steps", [500, 4000, 9000])
def test_stopped_process(steps: int, tmp_path: Path) -> None:
    """A process that the system stops for seconds: the motors stop dead, and that is said."""
    known = load_machine("klipper-uno")
    (tmp_path / "p.ngc").write_text(PROGRAM)
    simulator = simulator_for(known)
    with PtyServer(simulator) as server:
        command = [*COMMAND, str(tmp_path / "p.ngc"), "--machine", "klipper-uno"]
        process = subprocess.Popen(
            [*command, "--port", server.name, "--quiet"],
            env={**os.environ, "XDG_STATE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            wait_until(lambda: made(simulator) >= steps or process.poll() is not None)
            process.send_signal(signal.SIGSTOP)
            stopped = simulator.now
            wait_until(lambda: simulator.now > stopped + 1.0)
            with server.lock:
                rested = place(known, simulator)
            wait_until(lambda: simulator.now > stopped + 2.0)
            with server.lock:
                assert place(known, simulator) == rested
            process.send_signal(signal.SIGCONT)
            said = process.communicate(timeout=HANG)[1]
        finally:
            process.kill()
            process.wait(HANG)
        assert place(known, simulator) == rested
    assert process.returncode == 3
    assert "stopped without a ramp" in said
    assert "home the machine" in said
    x, y, _ = (each / 400 for each in rested)
    assert f"the machine is at X{x:.6g} Y{y:.6g}" in said


@pytest.mark.parametrize("moment", MOMENTS[: share(50, 1)])
@pytest.mark.parametrize("mcu", share(["atmega328p", "rp2040"], ["rp2040"]))
def test_pulled_cable(moment: float, mcu: str, tmp_path: Path) -> None:
    """The cable is pulled at any moment of the run; plugged in again, the board tells its place."""
    known = machine(mcu)
    (tmp_path / "p.ngc").write_text(PROGRAM)
    simulator = simulator_for(known)
    advance = simulator.advance

    def pulled(until: float, *, answer: bool = False) -> None:
        advance(until, answer=answer)
        if simulator.now >= moment and simulator.cable.plugged:
            simulator.cable.unplug()

    simulator.advance = pulled  # type: ignore[method-assign]
    with board(known, simulator) as (driver, _):
        report = run_with(tmp_path / "p.ngc", known, board=driver)
        arrived = driver._supervisor.connection.link.idle
    assert [fault.diagnostic.code for fault in report.faults] == ["port-lost"]
    advance(simulator.now + 1.0)
    rested = place(known, simulator)
    advance(simulator.now + 2.0)
    assert place(known, simulator) == rested
    ended = zip(report.end_position.values(), known.steps_per_mm, strict=True)
    told = np.array([round(mm * scale) for mm, scale in ended])
    # What was on the wire when the cable was pulled is not known to have arrived.
    assert np.abs(told - rested).max() <= (0 if arrived else IN_FLIGHT)
    assert not any(motor.active for motor in simulator.motors)
    simulator.advance = advance  # type: ignore[method-assign]
    simulator.cable.plugged = True
    port = KlipperSimulatorPort(simulator)
    again = Klipper(port, known, "again", clock=port)
    assert again._position.counts(again._supervisor.read_positions()) == rested
    assert again.known_steps == (None, None, None)

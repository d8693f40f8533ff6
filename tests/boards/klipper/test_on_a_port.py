"""The driver on a real board or simulator, by hand: ``CNC_KLIPPER_PORT`` names the port.

``CNC_KLIPPER_MACHINE`` names the machine file with the pins of the board. The supply of the motors
must be off. Without a port, the simulator serves a pseudo-terminal.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cnc.boards.klipper.driver import Klipper
from cnc.boards.port import SystemClock
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError
from cnc.simulators.klipper import ports
from cnc.simulators.klipper.ports import simulator_for
from tests.support.boards.klipper_rig import machine
from tests.support.boards.stepper_rig import chunks, eased, line
from tests.support.session.runs import run_with
from tests.support.waiting import wait_until

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")
ATTEMPTS = 8
SLOWER = 3.0
"""On the simulator a second takes so many real ones, so that a busy computer is seldom late."""
PORT, FILE = os.environ.get("CNC_KLIPPER_PORT"), os.environ.get("CNC_KLIPPER_MACHINE")


@pytest.fixture(scope="module")
def known() -> Machine:
    return machine() if PORT is None else load_machine(FILE)


def slow_time() -> float:
    return time.monotonic() / SLOWER


@pytest.fixture(scope="module")
def port(known: Machine) -> Iterator[str]:
    if PORT is not None:
        yield PORT
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SystemClock, "now", staticmethod(slow_time))
        patch.setattr(SystemClock, "sleep", lambda _, seconds: time.sleep(SLOWER * seconds))
        patch.setattr(ports, "time", SimpleNamespace(monotonic=slow_time))
        with ports.PtyServer(simulator_for(known)) as server:
            yield server.name


@pytest.fixture(autouse=True, scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep one state for all tests: an AVR cannot forget a configuration that is not known here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


def test_program(known: Machine, port: str, tmp_path: Path) -> None:
    """A busy computer may be too late for a move; then the board rests, and has another attempt."""
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X3 Y2 F900\nG3 X0 Y0 I-1.5 J-1\nG4 P0.2\nM2\n")
    for _ in range(ATTEMPTS):
        board = Klipper.from_machine(known, Path(port))
        try:
            report = run_with(tmp_path / "p.ngc", known, board=board)
        finally:
            board.close()
        if report.ok:
            break
        (fault,) = report.faults
        assert fault.diagnostic.code in ("board-underrun", "klipper-shutdown")
        # Without time for a ramp the motors stop at once; that loses the position of moved motors.
        rested = "rest on the path" in fault.diagnostic.message
        unmoved = "nothing has moved" in fault.diagnostic.message
        assert (rested or unmoved) == (None not in board.known_steps)
    assert report.ok, report.faults
    assert board.known_steps == (0, 0, 0)


@pytest.mark.soak
def test_position_is_known_to_the_next_program(known: Machine, port: str) -> None:
    for begin, end in ((0, 800), (800, 1600)):
        driver = Klipper.from_machine(known, Path(port))
        try:
            driver.start(np.array([begin, 0, 0]))
            for part in chunks(*eased(800, 200_000, (1.0, 0.0, 0.0))):
                driver.send(part)
            driver.finish()
        finally:
            driver.close()
        again = Klipper.from_machine(known, Path(port))
        assert again.known_steps == (end, 0, 0)
        again.close()


def stopped_sending(known: Machine, port: str) -> tuple[str, Klipper]:
    """Return the fault of a host that sends no more rows, and its driver."""
    board = Klipper.from_machine(known, Path(port))
    time_ns, step = line(20_000, 400_000)
    try:
        board.start(np.zeros(3, np.int64))
        for part in chunks(time_ns, step, 50):
            board.send(part)
            if part.line[-1] >= 2000:
                break
        wait_until(lambda: board._supervisor.fault is not None)
        board.send(next(chunks(time_ns[3000:], step[3000:], 50)))
    except BoardError as fault:
        return fault.diagnostic.code, board
    finally:
        board.close()
    return "", board


def test_host_that_stops_to_send_comes_to_rest(known: Machine, port: str) -> None:
    """The background thread makes the ramp while the program computes.

    A busy computer may be too late for a ramp; then the position is not known.
    """
    for _ in range(ATTEMPTS):
        code, board = stopped_sending(known, port)
        assert code
        if None not in board.known_steps:
            break
    assert code == "board-underrun"
    points = np.cumsum(line(20_000, 400_000)[1], axis=0, dtype=np.int64)
    assert (points == board.position_steps).all(axis=1).any()


def aborted(known: Machine, port: str) -> tuple[list[int], tuple[int | None, ...]]:
    """Return the position after an abort, and what of it is known."""
    board = Klipper.from_machine(known, Path(port))
    try:
        board.start(np.zeros(3, np.int64))
        for part in chunks(*line(20_000, 400_000), 50):
            board.send(part)
            if part.line[-1] >= 1000:
                break
        board.abort()
        return board.position_steps.tolist(), board.known_steps
    except BoardError:
        return [], (None, None, None)
    finally:
        board.close()


@pytest.mark.soak
def test_abort_knows_its_position(known: Machine, port: str) -> None:
    """A busy computer may be too late for a ramp; then the position is not known."""
    for _ in range(ATTEMPTS):
        position, found = aborted(known, port)
        if None not in found:
            break
    assert found == tuple(position)
    points = np.cumsum(line(20_000, 400_000)[1], axis=0, dtype=np.int64)
    assert (points == position).all(axis=1).any()

"""Kills in the middle of a run: the server, and the process that operates the machine."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from cnc.machine.load import load_machine
from cnc.simulators.grbl.firmware_profile import GRBL, settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.server.process import ServerProcess
from tests.support.waiting import wait_until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals and proc(5)")
STEP = 0.25
LINES = 400
RING, SHORTEST_LINE, BLOCKS = 128, 5, 16
"""Bytes of the ring, those of the shortest line, and the blocks of the planner."""
TEXT = "G21 G90 G61\nM3 S1000\n" + "".join(
    f"G1 X{STEP * k:.2f} F300\n" for k in range(1, LINES + 1)
)


@pytest.fixture
def simulator():
    return GrblSimulator(GRBL, settings=settings_of(load_machine("grbl-uno")))


@pytest.fixture
def terminal(simulator):
    from cnc.simulators.grbl.ports import PtyServer

    with PtyServer(simulator) as found:
        yield found


@pytest.fixture
def server(tmp_path, terminal, simulator):
    """A server that runs a program on the simulated board."""
    found = ServerProcess(tmp_path, "grbl-uno")
    found("POST", "connect", {"board": "grbl", "port": terminal.name})
    found("PUT", "jobs/long.nc", {"text": TEXT})
    found("POST", "jobs/long.nc/run", {"trust_position": True})
    wait_until(lambda: simulator.position[0] > 4.0)
    yield found
    found.close()


def wait_for_rest(simulator):
    """Wait until the machine has rested for a while of its own time.

    Between two lines it may rest for a moment: where this computer is busy, the bytes of the second
    one wait in the terminal.
    """
    core = simulator.core
    since = None

    def rests():
        nonlocal since
        if core.state != "Idle" or core.planner.blocks or core.receiver.ring:
            since = None
        elif since is None:
            since = core.now
        return since is not None and core.now - since > 0.5

    wait_until(rests)


def test_the_machine_rests_on_the_path_without_its_server(server, simulator, terminal, tmp_path):
    assert server.owner_of(terminal.name) != server.process.pid
    server.process.send_signal(signal.SIGKILL)
    server.process.wait()
    wait_for_rest(simulator)
    wait_until(lambda: simulator.core.spindle_text.startswith("M5"))
    assert 4.0 < simulator.position[0] < STEP * LINES
    assert simulator.lost == 0
    # The next run knows that this one did not finish, and so does the history.
    assert (tmp_path / "jobs" / "long.nc.checkpoint").is_file()
    again = ServerProcess(tmp_path, "grbl-uno")
    try:
        (run,) = again("GET", "history")
        assert (run["job"], run["outcome"]) == ("long.nc", "cut-off")
        # A client is told at once, with the line that was reached.
        last = again("GET", "unfinished")
        assert last["job"] == "long.nc"
        reached = simulator.position[0] / STEP + 2
        assert 4.0 / STEP < last["line"] <= reached + 1
        # A whole run ends this.
        again("PUT", "jobs/short.nc", {"text": "G21 G90\nG0 X1\nM2\n"})
        again("POST", "connect", {"board": "grbl-sim"})
        again("POST", "jobs/short.nc/run", {"trust_position": True})
        wait_until(lambda: again("GET", "history")[0]["outcome"] == "done")
        assert again("GET", "unfinished") is None
    finally:
        again.close()


def test_the_board_plays_its_lines_without_its_session(server, simulator, terminal, tmp_path):
    os.kill(server.owner_of(terminal.name), signal.SIGKILL)
    wait_until(lambda: server("GET", "state")["state"] == "disconnected")
    reached = simulator.position[0]
    wait_for_rest(simulator)
    end = simulator.position[0]
    assert end / STEP == pytest.approx(round(end / STEP), abs=0.01)
    assert end < STEP * LINES
    assert end - reached <= STEP * (RING / SHORTEST_LINE + BLOCKS + 1)
    assert simulator.lost == 0
    assert (tmp_path / "jobs" / "long.nc.checkpoint").is_file()
    wait_until(lambda: server("GET", "history")[0]["outcome"] != "running")
    run = server("GET", "history")[0]
    assert (run["outcome"], run["findings"][0]["code"]) == ("failed", "session-lost")
    # The server goes on, with a new process.
    server("POST", "connect", {"board": "grbl", "port": terminal.name})
    assert server("GET", "state")["board"] == "grbl"

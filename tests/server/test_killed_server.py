"""A server that is killed in the middle of a run: the board plays the lines that it has."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import urllib.request

import pytest

from cnc.boards.grbl.simulator.firmware_profile import GRBL
from cnc.boards.grbl.simulator.from_machine import settings_of
from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from cnc.kernels.code_cache import cache_folder
from cnc.machine.load import load_machine
from tests.support.paths import ROOT
from tests.support.waiting import wait_until

STEP = 0.25
LINES = 400
RING, SHORTEST_LINE, BLOCKS = 128, 5, 16
"""Bytes of the ring, those of the shortest line, and the blocks of the planner."""


@pytest.fixture
def simulator():
    return GrblSimulator(GRBL, settings=settings_of(load_machine("grbl-uno")))


@pytest.fixture
def server(simulator, tmp_path):
    """A server at the simulated board's terminal, and its address."""
    pty_server = pytest.importorskip("cnc.boards.grbl.simulator.pty_server")
    pytest.importorskip("termios")
    (tmp_path / "jobs").mkdir()
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "HOME": str(tmp_path),
        "XDG_STATE_HOME": str(tmp_path / "state"),
        "NUMBA_CACHE_DIR": str(cache_folder()),
    }
    arguments = ["serve", "--port", "0", "--library", "jobs", "--machine", "grbl-uno"]
    with pty_server.PtyServer(simulator) as terminal:
        process = subprocess.Popen(
            [sys.executable, "-m", "cnc.cli", *arguments],
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        with process:
            yield process, process.stdout.readline().strip(), terminal.name
            process.kill()


def test_the_board_plays_its_lines_and_rests(server, simulator, tmp_path):
    process, address, port = server
    key = ""

    def send(method, path, body):
        request = urllib.request.Request(
            f"{address}api/{path}",
            data=json.dumps(body).encode(),
            method=method,
            headers={"Content-Type": "application/json", "X-Control": key},
        )
        with urllib.request.urlopen(request, timeout=120) as answer:
            return json.loads(answer.read())

    key = send("POST", "control", {"client": "test"})["key"]
    send("POST", "connect", {"board": "grbl", "port": port})
    text = "G21 G90 G61\n" + "".join(f"G1 X{STEP * k:.2f} F300\n" for k in range(1, LINES + 1))
    send("PUT", "jobs/long.nc", {"text": text})
    send("POST", "jobs/long.nc/run", {"trust_position": True})
    wait_until(lambda: simulator.position[0] > 4.0)
    process.send_signal(signal.SIGKILL)
    process.wait()
    reached = simulator.position[0]
    wait_until(lambda: simulator.core.state == "Idle" and not simulator.core.planner.blocks)
    end = simulator.position[0]
    assert end / STEP == pytest.approx(round(end / STEP), abs=0.01)
    assert end < STEP * LINES
    assert end - reached <= STEP * (RING / SHORTEST_LINE + BLOCKS + 1)
    assert simulator.lost == 0
    # The next run knows that this one did not finish.
    assert (tmp_path / "jobs" / "long.nc.checkpoint").is_file()

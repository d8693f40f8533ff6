"""The command line with a board at a serial port (a pseudo-terminal), in real time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.serial_port import open_port
from cnc.boards.stepper.protocol import State, Status, StepperLink
from tests.support.boards.stepper_simulator import DIRECTION_PINS, STEP_PINS, built
from tests.support.paths import ROOT
from tests.support.waiting import HANG, wait_until

COMMAND = [sys.executable, "-c", "from cnc.cli import main; main()"]


class Terminal:
    """The simulator's program, its terminal, and the file of the pins' edges."""

    def __init__(self, folder: Path) -> None:
        self.edges = folder / "edges.csv"
        program = built()
        self.process = subprocess.Popen(
            [program / "simulator", program / "stepper.elf", self.edges],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout is not None
        self.name = ""
        while not self.name.startswith("/dev/"):
            self.name = self.process.stdout.readline().strip()

    def stop(self) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait(HANG)
        assert self.process.stdout is not None
        self.process.stdout.close()

    def position(self) -> list[int]:
        """Return the position that the edges of the pins add up to, steps."""
        level = dict.fromkeys(range(20), 0)
        at = [0, 0, 0]
        for _, pin, value in np.loadtxt(self.edges, delimiter=",", dtype=np.int64):
            level[int(pin)] = int(value)
            if pin in STEP_PINS[:3] and value:
                axis = STEP_PINS.index(int(pin))
                at[axis] += 1 - 2 * level[DIRECTION_PINS[axis]]
        return at


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    made = Terminal(tmp_path)
    yield made
    if made.process.poll() is None:
        made.stop()


def cncrun(*arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [*COMMAND, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        stdin=subprocess.DEVNULL,
        env=environment,
    )


def to_run(program: Path, terminal: Terminal) -> list[str]:
    """Return the arguments that run a program on the board behind a terminal."""
    machine = ["--machine", "stepper-uno", "--board", "stepper"]
    return [str(program), *machine, "--port", terminal.name]


def test_program_and_port_in_use(terminal: Terminal, tmp_path: Path) -> None:
    # It takes 0.095 s, so the board has all of it before it moves: a busy computer is never late.
    program = "G21 G90\nG1 X0.05 Y-0.0375 F1200\nG1 X0.1 Y0.0125 Z0.025\nM2\n"
    (tmp_path / "p.ngc").write_text(program)
    arguments = to_run(tmp_path / "p.ngc", terminal)
    with cncrun(*arguments) as first:
        out, error = first.communicate(timeout=HANG)
    assert first.returncode == 0, out + error
    holder = open_port(terminal.name, 1_000_000)
    with cncrun(*arguments) as second:
        _, error = second.communicate(timeout=HANG)
    holder.close()
    assert second.returncode == 3
    assert "port-taken" in error
    terminal.stop()
    assert terminal.position() == [40, 5, 10]


@pytest.mark.soak
def test_boards_command_reports_the_board(terminal: Terminal) -> None:
    with cncrun("boards", terminal.name) as listed:
        out, error = listed.communicate(timeout=HANG)
    assert listed.returncode == 0, error
    assert all(line.startswith("#") for line in out.splitlines())
    assert "# stepper board, version 1 of the protocol  idle" in out
    assert "# 3 axes (X Y Z), ticks of 500 ns" in out
    assert "baud = 1000000" in out
    terminal.stop()
    assert terminal.position() == [0, 0, 0]


def test_killed_host_leaves_the_machine_on_its_path(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X200 Y100 F2000\nM2\n")
    arguments = to_run(tmp_path / "p.ngc", terminal)
    with cncrun(*arguments) as host:
        wait_until(lambda: terminal.edges.stat().st_size >= 20_000)
        host.kill()
        host.communicate(timeout=HANG)
    port, link = open_port(terminal.name, 1_000_000), StepperLink()
    said: Status | None = None

    def is_at_rest() -> bool:
        """Ask after a silence in which the board must stop; a busy machine simulates it late."""
        nonlocal said
        time.sleep(0.8)
        link.ask()
        port.write(b"\0" + link.outgoing(time.monotonic()))
        for event in link.receive(port.read(0.05), time.monotonic()):
            said = event if isinstance(event, Status) else said
        return said is not None and said.state == State.ALARM

    wait_until(is_at_rest)
    port.close()
    terminal.stop()
    assert said is not None
    assert list(said.position[:3]) == terminal.position()
    x, y, _ = said.position[:3]
    assert 0 < x < 200 * 400
    assert abs(y - x / 2) <= 1, "it rests on the path"

"""The commands that a fault of a GRBL board advises, carried out: they lead to the right end."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cnc.simulators.grbl.grbl_simulator import Alarm, Error, GrblSimulator
from tests.support.boards.grbl_cable import GrblCable, grbl_cable
from tests.support.session.position_runs import FAST, SWITCHES

PROGRAM = "G21 G90\nG0 Z2\nG1 X6 F2000\nG1 Z-1 F600\nG1 X12 F900\nG1 Y8 F1500\nG1 X4\nG1 Y3\nM2\n"
END = (4.0, 3.0, -1.0)
FAULT_AT = 14
"""Lines that the board has read then: some of the program, and those of the connection."""
MACHINE = """
[axes.x]\nsteps_per_mm = 250\nmax_velocity = 80\nmax_acceleration = 400\nmax_jerk = 9000
travel = [TRAVEL]
[axes.y]\nsteps_per_mm = 250\nmax_velocity = 80\nmax_acceleration = 400\nmax_jerk = 9000
travel = [TRAVEL]
[axes.z]\nsteps_per_mm = 250\nmax_velocity = 80\nmax_acceleration = 400\nmax_jerk = 9000
travel = [TRAVEL]
[board]\nkind = "grbl"
"""


class Bench:
    """A simulated board at a cable, and the commands of its operator."""

    def __init__(
        self,
        cable: GrblCable,
        cncrun: Callable[..., tuple[int, str, str]],
        machine: Path,
        program: Path,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        self.simulator, self._cable, self._cncrun = cable.simulator, cable, cncrun
        self._options = ("--machine", str(machine), "--port", cable.name)
        self.program, self.monkeypatch = str(program), monkeypatch
        self.zero = self.stands()

    def stands(self) -> tuple[float, ...]:
        """Return the true position of the tool, mm."""
        offset = self.simulator.core.environment.offset
        return tuple(a + b for a, b in zip(self.simulator.position, offset, strict=True))

    def tool(self) -> tuple[float, ...]:
        """Return the same from the zero of the part."""
        return tuple(a - b for a, b in zip(self.stands(), self.zero, strict=True))

    def does(self, *arguments: str) -> tuple[int, str, str]:
        """Carry out a command; return exit code, standard output and standard error."""
        found = self._cncrun(*arguments, *self._options)
        assert not self._cable.is_open
        return found

    def succeeds(self, *arguments: str) -> str:
        """Carry out a command; return standard output."""
        code, out, err = self.does(*arguments)
        assert (code, arguments) == (0, arguments), err
        return out

    def fails(self, *arguments: str) -> str:
        """Carry out a command that ends with a fault of the board; return its last message."""
        code, _, err = self.does(*arguments)
        assert code == 3, err
        return err

    def move_to_zero(self) -> None:
        """Jog the tool to the zero of the part, as the operator sees it."""
        words = (f"{a}{-b:.3f}" for a, b in zip("XYZ", self.tool(), strict=True) if abs(b) > 0.01)
        self.succeeds("jog", *words, "--feed", "1500")


@pytest.fixture
def bench(
    request: pytest.FixtureRequest,
    cncrun: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Bench]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    homes = request.param
    machine, program = tmp_path / "machine.toml", tmp_path / "p.nc"
    machine.write_text(MACHINE.replace("TRAVEL", "-200, 0" if homes else "-200, 200"))
    program.write_text(PROGRAM)
    simulator = GrblSimulator(settings=SWITCHES if homes else FAST)
    with grbl_cable(simulator) as cable:
        bench = Bench(cable, cncrun, machine, program, monkeypatch)
        if homes:
            bench.succeeds("home")
            bench.succeeds("jog", "X-50", "Y-50", "Z-10", "--feed", "4000")
            bench.succeeds("zero", "X", "Y", "Z")
            bench.zero = bench.stands()
        yield bench


def advised(message: str) -> tuple[list[list[str]], str]:
    """Return the commands in the text of a fault, and the line to continue at."""
    line = re.search(r"--from-line (\d+)", message)
    assert line is not None, message
    return [each.split() for each in re.findall(r"\(cncrun ([^)]*)\)", message)], line[1]


def restart_in_the_second_move(bench: Bench) -> None:
    """Restart the board between X6 and X12, as soon as the sender has read where the tool is.

    Until then the board's clock hardly moves: a sender without a processor would miss the place.
    """
    simulator = bench.simulator
    read, advance = simulator.read, simulator.advance
    reports = 0

    def passed() -> bool:
        return bench.tool()[0] >= 9.0

    def counted() -> bytes:
        nonlocal reports
        data = read()
        reports += passed() and data.count(b"<")
        return data

    def watched(until: float, *, answer: bool = False) -> None:
        advance(min(until, simulator.now + 1e-3) if passed() else until, answer=answer)
        if reports >= 2:
            bench.monkeypatch.setattr(simulator, "advance", advance)
            bench.monkeypatch.setattr(simulator, "read", read)
            simulator.power_up(0.1)

    bench.monkeypatch.setattr(simulator, "advance", watched)
    bench.monkeypatch.setattr(simulator, "read", counted)


def break_off(bench: Bench, how: str) -> str:
    """Run the program until a fault; return the message."""
    simulator = bench.simulator
    if how == "restart":
        restart_in_the_second_move(bench)
    else:
        fault = Error(20) if how == "error" else Alarm(int(how))
        simulator.inject(fault, line=simulator.core.lines + FAULT_AT)
    return bench.fails(bench.program, "--yes", "--quiet")


@pytest.mark.parametrize("bench", [False], indirect=True)
@pytest.mark.parametrize("how", ["1", "3", "restart"])
def test_a_machine_that_does_not_home_ends_right(bench: Bench, how: str) -> None:
    commands, line = advised(break_off(bench, how))
    assert commands == [["home"], ["unlock"], ["zero", "X", "Y", "Z"]]
    bench.succeeds(*commands[1])
    bench.move_to_zero()
    bench.succeeds(*commands[2])
    assert "--trust-position" in bench.fails(bench.program, "--from-line", line, "--yes")
    bench.succeeds(bench.program, "--from-line", line, "--yes", "--trust-position")
    assert bench.tool() == pytest.approx(END, abs=0.02)


@pytest.mark.parametrize("bench", [True], indirect=True)
@pytest.mark.parametrize("how", ["1", "3", "restart"])
def test_a_machine_that_homes_ends_right(bench: Bench, how: str) -> None:
    commands, line = advised(break_off(bench, how))
    bench.succeeds(*commands[0])
    bench.succeeds(bench.program, "--from-line", line, "--yes")
    assert bench.tool() == pytest.approx(END, abs=0.02)


@pytest.mark.parametrize("bench", [False, True], indirect=True)
def test_after_a_refused_line_the_position_is_kept(bench: Bench) -> None:
    commands, line = advised(break_off(bench, "error"))
    assert not commands
    bench.succeeds(bench.program, "--from-line", line, "--yes")
    assert bench.tool() == pytest.approx(END, abs=0.02)


@pytest.mark.parametrize("bench", [False], indirect=True)
def test_each_command_on_a_locked_board_advises_to_unlock_it(bench: Bench) -> None:
    break_off(bench, "1")
    for command in (["jog", "X1"], ["zero", "X"], ["home"]):
        assert "cncrun unlock" in bench.fails(*command)
    assert "--trust-position" in bench.fails("mdi", "$X")
    assert "cncrun unlock" in bench.fails("mdi", "G0 X1", "--trust-position")
    assert "unlocked" in bench.succeeds("unlock")
    assert "was not locked" in bench.succeeds("unlock")
    bench.succeeds("jog", "X1")


@pytest.mark.parametrize("bench", [False], indirect=True)
def test_a_pressed_switch_keeps_the_board_locked(bench: Bench) -> None:
    """A board with hard limits locks itself again at the reset of each connection."""
    bench.succeeds("settings", "21=1", "--yes")
    environment = bench.simulator.core.environment
    environment.low = (-1e3, -1e3, -1e3)
    environment.high = (bench.stands()[0] + 8.0, 1e3, 1e3)
    assert "ALARM:1" in bench.fails(bench.program, "--yes", "--quiet")
    message = bench.fails("unlock")
    assert "limit switch of X" in message
    commands = re.findall(r"\(cncrun ([^)]*)\)", message)
    assert len(commands) == 4
    for command in commands:
        asks = ["--yes"] if "settings" in command else []
        bench.succeeds(*command.split(), *asks)
    assert bench.tool()[0] == pytest.approx(6.0, abs=0.1)
    assert "was not locked" in bench.succeeds("unlock")

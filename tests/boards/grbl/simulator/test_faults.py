"""The simulator with faults: their times, replays, arbitrary bytes, and a terminal."""

import ast
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cnc.simulators.grbl
from cnc.boards.port import PortLost
from cnc.boards.serial_port import open_port
from cnc.machine.load import load_machine
from cnc.simulators.grbl.firmware_profile import GRBL, GRBLHAL, settings_of
from cnc.simulators.grbl.grbl_simulator import (
    Alarm,
    Corrupt,
    Drop,
    Duplicate,
    Error,
    Freeze,
    GrblSimulator,
    ScheduledFault,
    Swallow,
    Unplug,
    parse_fault,
)
from cnc.simulators.grbl.ports import GrblSimulatorPort, PtyServer, ScaledTime
from tests.support.boards.simulator_bench import Bench
from tests.support.soak import share
from tests.support.waiting import HANG, wait_until

PROGRAM = "G21G90\nG1X10Y5F900\nG2X0Y0I-4J-3F600\nM3S500\nG4P0.2\nG91\nG0Z-1\nM5\n"


def received(bench):
    return [event.value for event in bench.simulator.events if event.kind == "line"]


@pytest.mark.parametrize(
    ("fault", "lines"),
    [
        (Drop(1), ["G21", "G0", "G94"]),
        (Drop(4), ["G21", "G94"]),
        (Drop(3), ["G21", "0G94"]),
        (Duplicate(1), ["G21", "GG90", "G94"]),
        (Corrupt(1), ["G21", "C90", "G94"]),
    ],
)
def test_faults_of_bytes(fault, lines):
    bench = Bench()
    bench.simulator.inject(fault, byte=5)
    bench.send("G21\nG90\nG94\n")
    expected = {Drop(1): ["G21", "90", "G94"], Drop(3): ["G21", "", "G94"]}.get(fault, lines)
    assert received(bench) == expected


def test_a_swallowed_reply_at_a_line():
    bench = Bench()
    bench.simulator.inject(Swallow(), line=2)
    assert bench.send("G21\nG1X\nG90\n") == ["ok", "ok"]
    assert received(bench) == ["G21", "G1X", "G90"]


def test_a_forced_error_at_a_line_is_not_carried_out():
    bench = Bench()
    bench.simulator.inject(Error(22), line=2)
    assert bench.send("G91\nG0X1\nG0Y1\n") == ["ok", "error:22", "ok"]
    bench.finish()
    assert bench.simulator.position == (0.0, 1.0, 0.0)


def test_a_frozen_board_answers_nothing_and_finishes_its_motion():
    bench = Bench()
    bench.send("G1X3F300\n", 0.2)
    bench.simulator.inject(Freeze())
    assert bench.send("?\nG1X5\n", 5.0) == []
    assert bench.simulator.position == (3.0, 0.0, 0.0)


def test_frozen_for_a_while():
    bench = Bench()
    bench.simulator.inject(Freeze(2.0), time=bench.simulator.now + 0.5)
    assert bench.send("", 1.0) == []
    assert bench.send("?", 1.0) == []
    assert len(bench.hear(1.0)) == 1


def test_unplugged():
    bench = Bench()
    bench.send("G1X3F300\n", 0.2)
    bench.simulator.inject(Unplug(), time=bench.simulator.now + 0.3)
    start = bench.simulator.now
    with pytest.raises(PortLost) as lost:
        bench.hear(9.0)
    assert bench.simulator.now - start < 0.5
    assert lost.value.diagnostic.code == "port-lost"
    with pytest.raises(PortLost):
        bench.port.write(b"?")
    # The board goes on by itself.
    bench.simulator.advance(bench.simulator.now + 5.0)
    assert bench.simulator.position == (3.0, 0.0, 0.0)
    assert GrblSimulatorPort(bench.simulator).read(3.0)


@pytest.mark.parametrize("profile", [GRBL, GRBLHAL])
@pytest.mark.parametrize("code", range(1, 11))
@pytest.mark.parametrize("moment", [0.05, 0.9, 2.1])
def test_an_alarm_at_any_time_stops_the_board(code, moment, profile):
    bench = Bench(profile)
    bench.simulator.inject(Alarm(code), time=bench.simulator.now + moment)
    heard = bench.send(PROGRAM, 8.0)
    assert f"ALARM:{code}" in heard
    alarm = next(event.time for event in bench.simulator.events if event.kind == "alarm")
    assert bench.simulator.moves == [] or bench.simulator.moves[-1].end_time <= alarm + 1e-9
    assert bench.simulator.core.spindle_text == "M5 0"
    if code in (1, 2) or (profile is GRBLHAL and code == 10):
        assert heard[-1] == "[MSG:Reset to continue]"
        assert bench.send("?\n") == []
    else:
        assert bench.status()["state"] == "Alarm"
    bench.send(b"\x18")
    assert bench.send("$X\n") == ["[MSG:Caution: Unlocked]", "ok"]
    stood = bench.simulator.position
    bench.hear(5.0)
    assert bench.simulator.position == stood


FAULTS = [
    ("drop:3@line:40", ScheduledFault(Drop(3), line=40)),
    ("duplicate@byte:7", ScheduledFault(Duplicate(1), byte=7)),
    ("corrupt:2", ScheduledFault(Corrupt(2))),
    ("swallow:1@time:2.5", ScheduledFault(Swallow(1), time=2.5)),
    ("freeze", ScheduledFault(Freeze())),
    ("freeze:2@line:3", ScheduledFault(Freeze(2.0), line=3)),
    ("unplug@time:1", ScheduledFault(Unplug(), time=1.0)),
    ("alarm:3@line:9", ScheduledFault(Alarm(3), line=9)),
    ("error:20@line:5", ScheduledFault(Error(20), line=5)),
]


@pytest.mark.parametrize(("text", "fault"), FAULTS)
def test_faults_are_parsed(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    "text", ["", "dropp", "drop:x", "alarm", "error:", "drop@word:3", "drop@line:x"]
)
def test_other_faults_are_refused(text):
    with pytest.raises(ValueError):
        parse_fault(text)


# The same bytes at the same moments


def record(seed_text, pauses):
    bench = Bench()
    heard = []
    for line, pause in zip(seed_text.splitlines(keepends=True), pauses, strict=False):
        heard += bench.send(line, pause)
    heard += bench.hear(5.0)
    return (
        heard,
        [(move.end, move.phases) for move in bench.simulator.moves],
        bench.simulator.events,
    )


@given(st.lists(st.floats(0.0, 0.7), min_size=8, max_size=8))
@settings(max_examples=10)
def test_a_replay_is_identical(pauses):
    assert record(PROGRAM, pauses) == record(PROGRAM, pauses)


@given(st.lists(st.floats(0.001, 0.5), min_size=1, max_size=30))
@settings(max_examples=20)
def test_the_steps_of_time_make_no_difference(steps):
    whole, cut = Bench(), Bench()
    for bench in (whole, cut):
        bench.port.write(PROGRAM.encode())
    for step in steps:
        cut.simulator.advance(cut.simulator.now + step)
    whole.simulator.advance(30.0)
    cut.simulator.advance(30.0)
    assert whole.simulator.read() == cut.simulator.read()
    assert [(move.end, move.phases) for move in whole.simulator.moves] == [
        (move.end, move.phases) for move in cut.simulator.moves
    ]


PIECES = st.one_of(
    st.binary(max_size=40),
    st.text("GMXYZIJKRFSPLTN0123456789.-+$=?!~#HC\n \x18\x84\x85\x90\x91\x96\x9e", max_size=60).map(
        lambda text: text.encode("latin-1")
    ),
    st.sampled_from(
        [
            b"\x18",
            b"$X\n",
            b"~",
            b"$H\n",
            b"G1X5F500\n",
            b"G2X1Y1R9\n",
            b"$J=X1F100\n",
            b"M0\n",
            b"$C\n",
            b"G10L2P1X3\n",
        ]
    ),
    st.from_regex(
        rb"(G[0-9]{1,2}(\.1)?|M[0-9]|[XYZIJKRFSPLTN]-?[0-9]{1,4}(\.[0-9]{1,3})?){1,6}\n",
        fullmatch=True,
    ),
)


@given(
    st.sampled_from([GRBL, GRBLHAL]), st.lists(st.tuples(PIECES, st.floats(0.0, 0.5)), max_size=30)
)
@settings(max_examples=share(3000, 35))
def test_arbitrary_bytes(profile, pieces):
    """Time advances, numbers stay finite, and after a reset it answers."""
    bench = Bench(profile, settings={22: 1.0, 21: 1.0, 110: 3000.0, 111: 3000.0, 112: 3000.0})
    for data, pause in pieces:
        bench.send(data, pause)
        assert all(abs(value) < 1e12 for value in bench.simulator.position)
        assert all(move.begin_time <= move.end_time for move in bench.simulator.moves)
        assert len(bench.simulator.toolpath()) == max(2 * len(bench.simulator.moves), 1)
    bench.simulator.advance(bench.simulator.now + 3.0)
    bench.port.read(0.0)
    bench.send(b"\x18\x18\n\n", 2.0)
    bench.send(b"\x18", 1.0)
    bench.send("$RST=*\n", 3.0)
    bench.send(b"\x18\n", 1.0)
    assert bench.status()["state"] in ("Idle", "Alarm", "Door:0")


# A clock that runs


def test_faster_than_real_time():
    simulator = GrblSimulator()
    port = GrblSimulatorPort(simulator, ScaledTime(simulator, 50.0), boot_time=0.5)
    begun = time.monotonic()
    heard = b""
    while b"help" not in heard:
        heard += port.read(1.0)
    port.write(b"G1X5F500\nG4P10\n")
    while heard.count(b"ok") < 2:
        heard += port.read(1.0)
    port.close()
    assert simulator.position == (5.0, 0.0, 0.0)
    # More than 10 s of the board, 50 times faster; a busy computer takes longer.
    assert time.monotonic() - begun > 0.2
    with pytest.raises(PortLost):
        port.read(0.0)


def exchange(file, data, until, seconds=HANG):
    """Write to a terminal, and read until ``until``."""
    os.write(file, data)
    heard, end = b"", time.monotonic() + seconds
    while until not in heard and time.monotonic() < end:
        try:
            heard += os.read(file, 1000)
        except BlockingIOError:
            time.sleep(0.005)
    return heard


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="there are no pseudo-terminals here")
def test_at_a_terminal():
    with PtyServer(GrblSimulator(), 20.0) as server:
        file = os.open(server.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            assert b"Grbl 1.1h" in exchange(file, b"", b"help]\r\n")
            assert exchange(file, b"G1X1F500\nG4P0\n", b"ok\r\nok\r\n") == b"ok\r\nok\r\n"
            assert b"MPos:1.000" in exchange(file, b"?", b">")
        finally:
            os.close(file)
        wait_until(lambda: not server.is_open)
        file = os.open(server.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            # Opened again: reset again.
            assert b"Grbl 1.1h" in exchange(file, b"", b"help]\r\n")
            server.simulator.inject(Unplug())
            assert server.wait(HANG)
        finally:
            os.close(file)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="there are no pseudo-terminals here")
def test_at_a_terminal_opened_as_a_serial_port():
    with PtyServer(GrblSimulator(), 20.0) as server:
        link = open_port(server.name, 115200)
        heard, end = b"", time.monotonic() + HANG
        while b"help]\r\n" not in heard and time.monotonic() < end:
            heard += link.read(0.1)
        link.write(b"$I\n")
        while not heard.endswith(b"ok\r\n") and time.monotonic() < end:
            heard += link.read(0.1)
        assert b"[OPT:V,15,128]" in heard
        server.simulator.inject(Unplug())
        with pytest.raises(PortLost):
            link.read(HANG)
        link.close()


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="there are no pseudo-terminals here")
def test_as_a_program():
    command = [
        sys.executable,
        "-m",
        "cnc.simulators.grbl",
        "--flavour",
        "grblhal",
        "--factor",
        "50",
        "--setting",
        "110=777",
    ]
    with subprocess.Popen(
        [*command, "--fault", "unplug@line:2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        name = process.stdout.readline().strip()
        file = os.open(name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            assert b"GrblHAL" in exchange(file, b"", b"help]\r\n")
            assert b"$110=777.000" in exchange(file, b"$$\n", b"ok")
            os.write(file, b"\n")
            assert process.wait(HANG) == 0
        finally:
            os.close(file)
    bad = subprocess.run(
        [*command, "--fault", "nothing"], capture_output=True, text=True, check=False
    )
    assert bad.returncode == 2 and "no fault is called 'nothing'" in bad.stderr


def test_the_simulator_imports_nothing_of_the_sender():
    """The simulator finds errors of the sender, so the two must not share code."""
    folder = Path(cnc.simulators.grbl.__file__).parent
    imported: set[str] = set()
    for module in set(folder.glob("*.py")) - {folder / "board.py"}:
        for node in ast.walk(ast.parse(module.read_text())):
            if isinstance(node, ast.ImportFrom):
                imported.add(node.module)
            elif isinstance(node, ast.Import):
                imported |= {name.name for name in node.names}
    assert {
        name
        for name in imported
        if name.startswith("cnc") and not name.startswith("cnc.simulators.grbl")
    } == {
        "cnc.boards.port",
        "cnc.machine.models",
        "cnc.model.blocks",
        "cnc.model.units",
        "cnc.simulators.terminal",
    }
    terminal = ast.parse((folder.parent / "terminal.py").read_text())
    imports = [node for node in ast.walk(terminal) if isinstance(node, ast.ImportFrom)]
    assert not [node.module for node in imports if node.module.startswith("cnc")]


def test_settings_of_a_machine_file():
    machine = load_machine(Path("config/grbl-uno.toml"))
    assert settings_of(machine) == {
        100: 800, 101: 800, 102: 800, 110: 1980, 111: 1980, 112: 900, 120: 250, 121: 250,
        122: 150, 130: 305, 131: 185, 132: 60
    }  # fmt: skip
    bench = Bench(settings=settings_of(machine) | {21: 1.0})
    bench.send("G0X200\n", 30.0)
    assert bench.simulator.position[0] == pytest.approx(152.5)

"""Laser power and outputs take effect at their place on the path, and the motion does not rest."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.api import Callbacks, Control, Machine, Report, RunOptions, check, load_machine
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.loopback import Loopback
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import AnalogOutput, Block, DigitalOutput, Held, Spindle
from cnc.model.streams import PulseChunk
from cnc.path.build import build
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.gcode.gcode_cases import read
from tests.support.session.runs import run_with
from tests.support.soak import share

MILL = load_machine("default")
LASER = MILL.model_copy(update={"kind": "laser"})
GRBL_LASER = load_machine("grbl-uno").model_copy(update={"kind": "laser"})
FAST = {32: 1.0, 30: 1000.0} | {
    110: 6000.0, 111: 6000.0, 112: 3000.0, 120: 800.0, 121: 800.0, 122: 400.0
}  # fmt: skip


class Recorder(Loopback):
    """A loopback board that keeps its pulses."""

    def __init__(self) -> None:
        super().__init__(3)
        self.chunks: list[PulseChunk] = []

    def send(self, chunk: PulseChunk) -> None:
        super().send(chunk)
        self.chunks.append(chunk)

    @property
    def time_ns(self) -> np.ndarray:
        return np.concatenate([chunk.time_ns for chunk in self.chunks])

    def steps_before(self, time_ns: int) -> np.ndarray:
        """Return the steps from the start (axes,) of all pulses before a time."""
        step = np.concatenate([chunk.step for chunk in self.chunks])
        return step[self.time_ns < time_ns].sum(axis=0, dtype=np.int64)

    def of(self, kind: type[Block]) -> list[tuple[int, Block]]:
        return [(time, block) for time, block in self.commands if isinstance(block, kind)]


def ran(
    tmp_path: Path, text: str, machine: Machine = MILL, **arguments: object
) -> tuple[Recorder, Report]:
    program = tmp_path / "p.nc"
    program.write_text(text)
    board = Recorder()
    report = run_with(program, machine, board=board, **arguments)
    assert report.ok, report.faults
    return board, report


def lines(count: int, *, step: float = 0.1, word: str = "", feed: int = 3000) -> str:
    moves = "".join(f"G1 X{step * k:.3f} {word.format(k=k)}\n" for k in range(1, count + 1))
    return f"G21 G90\nM3 S1000\nF{feed}\n{moves}M5\nM2\n"


def test_words_that_change_nothing_cost_no_time(tmp_path: Path) -> None:
    plain = ran(tmp_path, lines(200))[1].duration_s
    for word in ("S1000", "M3", "M3 S1000", "F3000", "M9", "M48", "S1000 M3 F3000"):
        board, report = ran(
            tmp_path, lines(200, word=word).replace("F3000\nG1", "M9 M48 F3000\nG1")
        )
        assert report.duration_s == pytest.approx(plain, rel=1e-9), word
        assert len(board.of(Spindle)) == 2


@pytest.mark.parametrize("stop", ["M0", "M60", "T2 M6"])
def test_the_spindle_is_commanded_again_after_a_stop(stop: str) -> None:
    """The operator may have switched it off by hand meanwhile."""
    text = f"G21 G90 T1\nM3 S1000\nG1 X1 F600\nM3 S1000\n{stop}\nM3 S1000\nG1 X2\nM2\n"
    blocks = read(Text.of_lines(text.splitlines(), "p.nc"))
    spindles = [block.line for block in blocks if isinstance(block, Spindle)]
    assert {2, 6} <= set(spindles) and 4 not in spindles


@pytest.mark.parametrize(
    ("word", "kind", "machine"),
    [
        ("S{k}", Spindle, LASER),
        ("M3 S{k}", Spindle, LASER),
        ("M62 P{k}", DigitalOutput, MILL),
        ("M63 P{k}", DigitalOutput, MILL),
        ("M67 E1 Q{k}", AnalogOutput, MILL),
        ("M68 E1 Q{k}", AnalogOutput, MILL),
    ],
)
def test_a_command_in_motion_acts_at_its_place(
    word: str, kind: type[Block], machine: Machine, tmp_path: Path
) -> None:
    count = 40
    text = lines(count, step=0.5, word="\n" if kind is Spindle else "")
    parts = text.split("G1 ")
    with_words = parts[0] + "".join(
        f"{word.format(k=k)}\nG1 {part}" for k, part in enumerate(parts[1:], 1)
    )
    plain, _ = ran(tmp_path, text, machine)
    board, _ = ran(tmp_path, with_words, machine)
    assert (board.time_ns == plain.time_ns).all()
    found = [each for each in board.of(kind) if not (kind is Spindle and each[1].line < 4)]
    found = [each for each in found if getattr(each[1], "state", "on") != "off"]
    assert len(found) == count
    per_mm = machine.axes["x"].steps_per_mm
    for k, (time, _) in enumerate(found):
        assert abs(board.steps_before(time)[0] - 0.5 * k * per_mm) <= 1.0


@pytest.mark.parametrize(
    ("word", "machine"),
    [("M64 P{k}", MILL), ("M65 P{k}", MILL), ("S{k}", MILL), ("M66 P0 L0", MILL)],
)
def test_other_commands_bring_the_motion_to_rest(
    word: str, machine: Machine, tmp_path: Path
) -> None:
    text = lines(20, step=0.5)
    stopping = text.replace("G1 ", "{}\nG1 ").format(*(word.format(k=k) for k in range(20)))
    assert ran(tmp_path, stopping, machine)[1].duration_s > 2.0 * ran(tmp_path, text)[1].duration_s


@pytest.mark.parametrize("machine", [MILL, LASER])
def test_a_check_counts_each_move_and_each_speed(tmp_path: Path, machine: Machine) -> None:
    program = tmp_path / "p.nc"
    program.write_text("G21 G90 G1 F600\nM3 S1\nX1 S2\nX2 S3\nS4\nS5\nX3\nX3 S6\nS7\nM5\nM2\n")
    # M3, X1 and S2, X2 and S3, S4, S5, X3, X3 and S6, S7, M5, M2.
    assert check(program, machine).blocks == 1 + 2 + 2 + 2 + 1 + 2 + 1 + 2


MOVES = st.sampled_from(
    ["G1 X{a} Y{b}", "G1 X{a}", "G2 X{a} Y{b} R60", "G3 X{a} Y{b} R70", "G0 X{b}", "G1 Y{b} Z-{c}"]
)
MODES = st.sampled_from(["", "", "G64 P0.05", "G61", "G61.1", "G4 P0.01", "M8", "G41.1 D1"])


@settings(max_examples=share(400, 8), deadline=None)
@given(
    st.lists(
        st.tuples(MODES, st.booleans(), MOVES, *[st.integers(0, 9)] * 3), min_size=1, max_size=14
    ),
    st.sampled_from([LASER, MILL]),
)
def test_every_command_acts_once_and_in_order(
    tmp_path_factory: pytest.TempPathFactory,
    parts: list[tuple[str, bool, str, int, int, int]],
    machine: Machine,
) -> None:
    text, expected = "G21 G90 F2000\nM3 S5\n", [5]
    for k, (mode, changes, move, a, b, c) in enumerate(parts, 10):
        text += f"{mode}\n" if mode and not mode.startswith("G41") else ""
        if changes:
            text += f"M67 E0 Q{k}\nS{k}\n"
            expected.append(k)
        text += move.format(a=a, b=b, c=c) + "\n"
    board, _ = ran(tmp_path_factory.mktemp("p"), text + "M5\nM2\n", machine)
    powers = [block.rpm for _, block in board.of(Spindle) if block.state != "off"]
    assert powers == expected
    assert [block.value for _, block in board.of(AnalogOutput)] == expected[1:]
    times = [time for time, _ in board.commands]
    assert times == sorted(times)


def test_the_beam_is_off_during_a_hold(tmp_path: Path) -> None:
    control = Control()

    def on_sent(sent: Progress) -> None:
        if sent.held:
            control.resume()
        elif sent.time > 0.2 and not board.of(Held):
            control.hold()

    program = tmp_path / "p.nc"
    program.write_text(lines(400, word="S{k}"))
    board = Recorder()
    report = run_with(
        program, LASER, board=board, control=control, callbacks=Callbacks(on_sent=on_sent)
    )
    assert report.ok, report.faults
    kinds = [block for _, block in board.commands]
    held = next(k for k, block in enumerate(kinds) if isinstance(block, Held))
    before, off, on = kinds[held - 2], kinds[held - 1], kinds[held + 1]
    assert isinstance(off, Spindle)
    assert off.state == "off"
    assert on is before
    powers = [block.rpm for block in kinds if isinstance(block, Spindle) and block.state == "cw"]
    powers.remove(on.rpm)
    assert powers == [1000, *range(1, 401)]


@given(st.lists(st.tuples(st.floats(0.5, 20.0), st.floats(1.0, 60.0)), min_size=1, max_size=6))
@settings(max_examples=share(200, 6), deadline=None)
def test_times_of_places_invert_the_plan(moves: list[tuple[float, float]]) -> None:
    from cnc.model.blocks import Polyline

    ends = np.zeros((len(moves), 3))
    ends[:, 0] = np.cumsum([length for length, _ in moves])
    block = Polyline(
        "p", 1, ends, np.array([feed for _, feed in moves]), np.ones(len(moves), np.int32)
    )
    for item in LookAhead(MILL).plan(build([block], axes=("x", "y", "z"), start=np.zeros(3))):
        assert isinstance(item, PlanChunk)
        places = np.linspace(float(item.phase_s[0]), float(item.phase_s[-1]), 50)
        times = item.times_at(places)
        k = np.clip(
            np.searchsorted(item.phase_t, times, side="right") - 1, 0, len(item.phase_j) - 1
        )
        dt = times - item.phase_t[k]
        reached = item.phase_s[k] + dt * (
            item.phase_v[k] + dt * (item.phase_a[k] / 2 + dt * item.phase_j[k] / 6)
        )
        assert np.abs(reached - places).max() < 1e-9
        assert (np.diff(times) >= 0.0).all()


# On GRBL


def on_grbl(
    tmp_path: Path, text: str, machine: Machine, **changed: float
) -> tuple[GrblSimulator, Report]:
    program = tmp_path / "p.nc"
    program.write_text(text)
    box = GrblSimulator(settings=FAST | {int(name[1:]): value for name, value in changed.items()})
    port = GrblSimulatorPort(box)
    board = GrblBoard(port, machine, port.clock, "the simulator")
    board.connect()
    report = run_with(program, machine, board=board)
    board.close()
    return box, report


def raster(rows: int, columns: int, pitch: float = 0.5, overscan: float = 3.0) -> str:
    text = "G21 G90\nM4 S0\nF2000\n"
    for row in range(rows):
        pixels = range(columns) if row % 2 == 0 else range(columns - 1, -1, -1)
        out = -overscan if row % 2 == 0 else columns * pitch + overscan
        text += f"G0 X{out:.2f} Y{row * pitch:.2f}\n"
        text += f"G1 X{0.0 if row % 2 == 0 else columns * pitch:.2f} S0\n"
        for k in pixels:
            edge = (k + 1 if row % 2 == 0 else k) * pitch
            text += f"X{edge:.2f} S{power(row, k)}\n"
        text += f"X{columns * pitch + overscan if row % 2 == 0 else -overscan:.2f} S0\n"
    return text + "M5\nM2\n"


def power(row: int, column: int) -> int:
    return (row * 131 + column * 277) % 900 + 50


def test_a_raster_on_a_laser_is_engraved_without_stops(tmp_path: Path) -> None:
    rows, columns, pitch = 3, 30, 0.5
    box, report = on_grbl(tmp_path, raster(rows, columns, pitch), GRBL_LASER)
    assert report.ok, report.faults
    moves = [move for move in box.moves if move.kind == "feed"]
    for row in range(rows):
        own = [m for m in moves if abs(m.start[1] - row * pitch) < 0.01 and m.start[1] == m.end[1]]
        for column in range(columns):
            middle = (column + 0.5) * pitch
            (over,) = [
                m for m in own if min(m.start[0], m.end[0]) < middle < max(m.start[0], m.end[0])
            ]
            assert over.spindle == ("M4", power(row, column))
            # Each pixel ends where the program says, to a step of the machine.
            edges = sorted((over.start[0], over.end[0]))
            assert edges == pytest.approx([column * pitch, (column + 1) * pitch], abs=0.004)
        inside = [m for m in own if -0.01 < m.start[0] < columns * pitch + 0.01]
        # No pixel begins slower than the feed: the overscan has taken the ramps.
        begun = [
            m.phases[0].v for m in inside if abs(m.start[0] - m.end[0]) > 0.1 and m.spindle[1] > 0
        ]
        assert min(begun) == pytest.approx(2000.0 / 60.0, rel=0.01)
    # Overscan stays: moves with S0, as far as programmed.
    assert min(m.end[0] for m in box.moves) == pytest.approx(-3.0, abs=0.004)
    assert {m.spindle[1] for m in moves if min(m.start[0], m.end[0]) < -1.0} == {0.0}
    played = box.moves[-1].end_time - box.moves[0].begin_time
    assert report.duration_s == pytest.approx(played, rel=0.03)


def test_a_lone_speed_stops_the_motion_also_in_laser_mode(tmp_path: Path) -> None:
    """The simulator shows what real GRBL does; the reason for S words in the lines of moves."""
    from tests.support.boards.simulator_bench import Bench

    def seconds(text: str, laser: float) -> float:
        bench = Bench(settings=FAST | {32: laser})
        bench.send(f"M4S1\nG1F2000X1S5\n{text}", 30.0)
        return bench.simulator.moves[-1].end_time - bench.simulator.moves[0].begin_time

    inline = "".join(f"X{2 + k}S{10 + k}\n" for k in range(8))
    alone = "".join(f"S{10 + k}\nX{2 + k}\n" for k in range(8))
    assert seconds(alone, 1.0) > seconds(inline, 1.0) + 8 * 0.03
    assert seconds(inline, 0.0) == pytest.approx(seconds(alone, 0.0), abs=0.05)


def test_the_time_of_a_mill_with_changing_speeds_counts_the_stops(tmp_path: Path) -> None:
    text = "G21 G90\nM3 S100\nF2000\n" + "".join(f"G1 X{k} S{100 + k}\n" for k in range(1, 40))
    mill = load_machine("grbl-uno")
    box, report = on_grbl(tmp_path, text + "M5\nM2\n", mill, S32=0.0)
    assert report.ok, report.faults
    played = box.moves[-1].end_time - box.moves[0].begin_time
    assert report.duration_s == pytest.approx(played, rel=0.03)


def test_a_laser_is_refused_on_a_board_without_laser_mode(tmp_path: Path) -> None:
    box, report = on_grbl(tmp_path, "G1 X1 F100\nM2\n", GRBL_LASER, S32=0.0)
    assert [fault.diagnostic.code for fault in report.faults] == ["laser-mode-off"]
    assert not box.moves


def test_laser_mode_of_the_board_makes_the_machine_a_laser(tmp_path: Path) -> None:
    text = "G21 G90\nM4 S10\nG1 X1 F1000\nX2 S20\nX3 S30\nM5\nM2\n"
    box, report = on_grbl(tmp_path, text, load_machine("grbl-uno"))
    assert report.ok, report.faults
    assert [m.spindle[1] for m in box.moves] == [10.0, 20.0, 30.0]
    assert box.moves[1].phases[0].v > 0.0


def test_a_laser_that_begins_at_a_line_has_no_power_before_it(tmp_path: Path) -> None:
    text = "G21 G90\nM3 S200\nG1 X5 F1000\nX10 S300\nX20 S400\nX30 S500\nM5\nM2\n"
    board, _ = ran(tmp_path, text, LASER, from_line=5)
    per_mm = LASER.axes["x"].steps_per_mm
    powers = [
        (block.rpm, round(board.steps_before(time)[0] / per_mm))
        for time, block in board.of(Spindle)
        if block.state == "cw"
    ]
    # The power before line 5 and that of line 5 itself, at one place.
    assert powers == [(0.0, 10), (300.0, 10), (400.0, 10), (500.0, 20)]


def test_check_reports_the_time_of_a_laser(tmp_path: Path) -> None:
    program = tmp_path / "p.nc"
    program.write_text(lines(100, word="S{k}"))
    laser = check(program, LASER, RunOptions()).duration_s
    program.write_text(lines(100))
    assert laser == pytest.approx(check(program, LASER, RunOptions()).duration_s)
    assert math.isfinite(laser)


@pytest.mark.parametrize("pitch", share([0.1, 0.2, 0.5], [0.2]))
def test_a_raster_streams_as_fast_as_by_plain_character_counting(
    tmp_path: Path, pitch: float
) -> None:
    pixels = [f"X{pitch * k:.2f}S{power(0, k)}" for k in range(1, 400)]
    program = ["G21G90", "M4S0", "G1F2000", *pixels]
    plain = GrblSimulator(settings=FAST)
    port = GrblSimulatorPort(plain)
    heard = b""
    while b"help]" not in heard and plain.now < 5.0:
        heard += port.read(2.0)
    sizes: list[int] = []

    def listen() -> None:
        nonlocal heard
        *answers, heard = (heard + port.read(0.05)).split(b"\n")
        del sizes[: sum(answer.strip() == b"ok" for answer in answers)]

    for line in program:
        while sum(sizes) + len(line) + 1 > 127 and plain.now < 60.0:
            listen()
        port.write(line.encode() + b"\n")
        sizes.append(len(line) + 1)
    end = plain.now + 60.0
    while (sizes or plain.core.planner.blocks) and plain.now < end:
        listen()
    assert not sizes
    box, report = on_grbl(tmp_path, "\n".join([*program, "M2"]), GRBL_LASER)
    assert report.ok, report.faults

    def seconds(simulator: GrblSimulator) -> float:
        return simulator.moves[-1].end_time - simulator.moves[0].begin_time

    assert seconds(box) <= 1.03 * seconds(plain)
    assert report.duration_s == pytest.approx(seconds(box), rel=0.03)

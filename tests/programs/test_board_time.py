"""The time of a program on a GRBL board: by theory, and in the simulator."""

import math
import random
from collections import deque
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.api import parse, start_position
from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import SHORT_LINE_TIME, BoardTime, Countdown
from cnc.grbl_lines.translator import Translator
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.streams import PackedLines
from cnc.path.build import exact_path
from cnc.simulators.grbl.firmware_profile import settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.line_reader import lines_with_effects
from tests.support.paths import PROGRAMS
from tests.support.programs.random_programs import random_program
from tests.support.soak import share

MILL = load_machine(None)
LIMITS = BoardLimits((50.0, 50.0, 10.0), (200.0, 200.0, 50.0), junction_deviation=0.01)


def seconds(texts: Iterable[str], limits: BoardLimits = LIMITS) -> float:
    clock = BoardTime(limits)
    for line in lines_with_effects(texts):
        clock.add(line)
    clock.end()
    return clock.seconds


def ramp(length: float, v: float, a: float) -> float:
    """Return the time of a move from rest to rest with speed limit v and acceleration a."""
    return length / v + v / a if length >= v * v / a else 2.0 * math.sqrt(length / a)


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["G1 X100 F1200"], ramp(100.0, 20.0, 200.0)),
        (["G0 X100"], ramp(100.0, 50.0, 200.0)),
        (["G0 Z-30"], ramp(30.0, 10.0, 50.0)),
        (["G1 X1 F3000"], ramp(1.0, 50.0, 200.0)),
        # the slow axis binds: 3-4-5 with z at 10 mm/s and 50 mm/s^2
        (["G0 X30 Z-40"], ramp(50.0, 12.5, 62.5)),
        # there and back, and at a dwell, it rests
        (["G1 X10 F600", "G1 X0"], 2.0 * ramp(10.0, 10.0, 200.0)),
        (["G1 X10 F600", "G4 P1.5", "G1 X20"], 2.0 * ramp(10.0, 10.0, 200.0) + 1.5),
        # behind an M code the next line is read at rest
        (["G1 X10 F600", "M3 S100", "G1 X20"], 2.0 * ramp(10.0, 10.0, 200.0) + SHORT_LINE_TIME),
        # straight on it doesn't slow down
        (["G1 X10 F600", "G1 X20"], ramp(20.0, 10.0, 200.0)),
    ],
)
def test_ramps(texts, expected):
    assert seconds(texts) == pytest.approx(expected, rel=1e-9)


def test_a_right_angle_is_passed_at_the_speed_of_its_junction_deviation():
    # the junction's pull is along the diagonal, where both axes give 200: 282.8 mm/s^2
    half = math.sqrt(0.5)
    v = math.sqrt(200.0 * math.sqrt(2.0) * 0.01 * half / (1.0 - half))
    leg = 10.0 / 10.0 + 10.0 / 200.0 / 2.0 + (10.0 - v) ** 2 / (2.0 * 200.0 * 10.0)
    assert seconds(["G1 X10 F600", "Y10"]) == pytest.approx(2.0 * leg, rel=1e-9)


def test_speed_is_limited_by_the_blocks_ahead():
    """The top speed of very short moves is that from which 15 of them suffice to stop."""
    texts = [f"G1 X{0.01 * k:.2f} F3000" for k in range(1, 2001)]
    top = math.sqrt(2.0 * 200.0 * 15 * 0.01)
    assert seconds(texts) == pytest.approx(20.0 / top, rel=0.05)


def lines_of(program: Path | str, machine: Machine) -> list[str]:
    """Return the lines of a program, without those that wait for the operator."""
    blocks = parse(program, machine, dialect="auto")
    translator = Translator(machine)
    path = exact_path(blocks, axes=machine.axis_names, start=start_position(machine))
    lines = [line for item in path for line in translator.lines(item)]
    return [
        line.text
        for line in (*lines, *translator.end())
        if not line.text.startswith(("M0", "M1", "M2", "("))
    ]


def simulated_seconds(texts: Iterable[str], machine: Machine) -> float:
    """Return the time of lines in the simulator, with its ring of 128 bytes kept full."""
    simulator = GrblSimulator(settings=settings_of(machine) | {20: 0.0})
    port = GrblSimulatorPort(simulator, boot_time=0.0)
    while port.read(0.5):
        pass
    begin, left, flight, answers = simulator.now, deque(texts), deque[int](), b""
    while left or flight:
        while left and sum(flight) + len(left[0]) + 1 <= 127:
            line = left.popleft().encode() + b"\n"
            flight.append(len(line))
            port.write(line)
        *whole, answers = (answers + port.read(1.0)).split(b"\n")
        for answer in whole:
            assert not answer.startswith((b"error", b"ALARM")), answer
            if answer.strip() == b"ok":
                flight.popleft()
    while simulator.core.steppers.running:
        simulator.advance(simulator.now + 0.001)
    port.close()
    return simulator.now - begin


@pytest.mark.parametrize(
    "file",
    [
        "trident",
        "engraving",
        "bezier",
        "thread-mill",
        "drilling",
        *share(["finishing", "pocket"], []),
    ][:: share(1, 2)],
)
def test_shipped_programs_take_as_long_as_in_the_simulator(file):
    texts = lines_of(PROGRAMS / f"{file}.nc", MILL)
    assert seconds(texts, BoardLimits.of_machine(MILL)) == pytest.approx(
        simulated_seconds(texts, MILL), rel=0.05, abs=0.02
    )


@settings(max_examples=share(200, 6))
@given(seed=st.integers(0, 10**6))
def test_random_programs_take_as_long_as_in_the_simulator(seed, tmp_path_factory):
    program = tmp_path_factory.mktemp("random") / "p.nc"
    program.write_text(random_program(seed))
    texts = lines_of(program, MILL)
    assert seconds(texts, BoardLimits.of_machine(MILL)) == pytest.approx(
        simulated_seconds(texts, MILL), rel=0.05, abs=0.03
    )


def walk(step: float, turn: float, word: str) -> list[str]:
    """Return moves of one length in random directions near each other."""
    rng, at, heading = random.Random(4), [50.0, 50.0], 0.0
    lines = ["G21 G90", "G0 X50 Y50", "G1 F3000"]
    for _ in range(1000):
        heading += math.radians(rng.gauss(0.0, turn))
        at[0] += step * math.cos(heading)
        at[1] += step * math.sin(heading)
        lines.append(f"{word} X{at[0]:.3f} Y{at[1]:.3f}")
    return lines


@pytest.mark.parametrize(
    ("steps_per_mm", "step", "turn", "word"),
    [
        # a step of 0.0125 mm turns moves of 0.4 mm by up to 2 degrees
        (80.0, 0.4, 4.0, "G0"),
        (80.0, 0.2, 8.0, "G1"),
        # the planner can't look ahead as far as the board has to brake
        (800.0, 0.125, 0.7, "G0"),
    ][share(0, 2) :],
)
def test_short_moves_take_as_long_as_in_the_simulator(steps_per_mm, step, turn, word):
    axes = {
        letter: axis.model_copy(
            update={
                "steps_per_mm": steps_per_mm,
                "max_velocity": 100.0,
                "max_acceleration": 1000.0 if steps_per_mm < 100.0 else 250.0,
                "travel": (-500.0, 500.0),
            }
        )
        for letter, axis in MILL.axes.items()
    }
    machine = MILL.model_copy(update={"axes": axes})
    texts = walk(step, turn, word)
    expected = simulated_seconds(texts, machine)
    assert seconds(texts, BoardLimits.of_machine(machine)) == pytest.approx(
        expected, rel=0.01, abs=0.05
    )


def test_the_look_ahead_is_that_of_the_board():
    texts = walk(0.125, 0.7, "G0")
    uno, hal = (BoardLimits.of_board(MILL, {}, places) for places in (15, 35))
    assert uno.blocks == 14 and hal.blocks == 34
    assert seconds(texts, hal) < seconds(texts, uno)


def test_rows_take_as_long_as_their_lines():
    texts = [*lines_of(PROGRAMS / "engraving.nc", MILL), *walk(0.2, 8.0, "G1")]
    lines = list(lines_with_effects(texts))
    one_by_one, at_once = BoardTime(LIMITS), BoardTime(LIMITS)
    for line in lines:
        one_by_one.add(line)
    packed = PackedLines.of(lines)
    at_once.add_rows(packed.rows, packed.sizes)
    one_by_one.end()
    at_once.end()
    assert at_once.seconds == pytest.approx(one_by_one.seconds, rel=1e-12)
    for done in range(0, len(lines), 50):
        assert at_once.remaining(done) == pytest.approx(one_by_one.remaining(done), rel=1e-12)


def test_batches_make_no_difference(monkeypatch):
    texts = lines_of(PROGRAMS / "bezier.nc", MILL)
    whole = seconds(texts, BoardLimits.of_machine(MILL))
    monkeypatch.setattr("cnc.grbl_lines.grbl_timing.BATCH", 40)
    assert seconds(texts, BoardLimits.of_machine(MILL)) == pytest.approx(whole, rel=1e-9)


def clock_of(texts: list[str], limits: BoardLimits) -> BoardTime:
    clock = BoardTime(limits)
    for line in lines_with_effects(texts):
        clock.add(line)
    clock.end()
    return clock


def slowed(texts: list[str], feed: float) -> list[str]:
    """Return the lines with every F word times a factor."""
    return [
        " ".join(f"F{float(w[1:]) * feed:.6f}" if w[0] == "F" else w for w in text.split())
        for text in texts
    ]


@pytest.mark.parametrize("percent", [10, 30, 50, 80, 100, 140, 200])
def test_overrides_change_what_remains(percent):
    texts = lines_of(PROGRAMS / "pocket.nc", MILL)
    limits = BoardLimits.of_machine(MILL)
    clock = clock_of(texts, limits)
    expected = seconds(slowed(texts, percent / 100.0), limits)
    assert clock.remaining(0, percent) == pytest.approx(expected, rel=0.02)
    assert clock.remaining(len(texts), percent) == 0.0
    done = [clock.remaining(k, percent) for k in range(len(texts) + 1)]
    assert done == sorted(done, reverse=True)


def test_rapid_overrides_slow_the_traverses_alone():
    clock = clock_of(["G0 X100", "G1 X0 F1200"], LIMITS)
    feed = ramp(100.0, 20.0, 200.0)
    for percent in (25.0, 50.0, 100.0):
        assert clock.remaining(0, 100.0, percent) == pytest.approx(
            ramp(100.0, 0.5 * percent, 200.0) + feed
        )


def test_lines_without_motion_reduce_no_time():
    clock = clock_of(
        ["G21 G90 G94 G17 G54", "(MSG, on)", "G0 X100", "M8", "G4 P5", "G1 X0 F1200"], LIMITS
    )
    there, back = ramp(100.0, 50.0, 200.0), ramp(100.0, 20.0, 200.0)
    waits = 5.0 + SHORT_LINE_TIME
    expected = [there + waits + back] * 3 + [waits + back, 5.0 + back, back, 0.0]
    assert [clock.remaining(k) for k in range(7)] == pytest.approx(expected)


def test_the_number_of_marks_is_bounded():
    texts = [f"G1 X{k % 7} Y{k % 3} F600" for k in range(20000)]
    clock = clock_of(texts, LIMITS)
    assert len(clock._marks) <= 4096
    assert clock.remaining(10000) == pytest.approx(0.5 * clock.seconds, rel=0.01)


def test_a_countdown_follows_lines_and_clock():
    clock = clock_of([f"G1 X{100 * k} F600" for k in range(1, 7)], LIMITS)
    count = Countdown(clock)
    whole = clock.seconds
    assert count.left(100.0, 0, held=False) == pytest.approx(whole)
    assert count.left(103.0, 0, held=False) == pytest.approx(whole - 3.0)
    # held: the clock stands; a pause takes nothing away
    assert count.left(160.0, 0, held=True) == pytest.approx(whole - 3.0)
    assert count.left(161.0, 0, held=False) == pytest.approx(whole - 4.0)
    # half as fast: what is left takes twice as long
    assert count.left(161.0, 0, held=False, feed_override=50.0) == pytest.approx(
        2.0 * (whole - 4.0), rel=0.02
    )
    # the board is known to have carried out the fourth line; or to be no farther than two lines
    # behind the fourth
    assert count.left(162.0, 4, held=False) == pytest.approx(clock.remaining(4))
    assert count.left(1000.0, 4, held=False) == 0.0
    assert count.left(1001.0, 6, held=False) == 0.0


def test_settings_of_the_board_override_the_machine_file():
    limits = BoardLimits.of_board(MILL, {110: 600.0, 120: 100.0, 11: 0.02})
    assert limits.rates == (10.0, MILL.axes["y"].max_velocity, MILL.axes["z"].max_velocity)
    assert limits.accelerations == (
        100.0,
        MILL.axes["y"].max_acceleration,
        MILL.axes["z"].max_acceleration,
    )
    assert (limits.junction_deviation, limits.arc_tolerance) == (0.02, 0.002)

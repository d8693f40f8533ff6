"""Holds, overrides and stops at machine times: the same pulses, in the time of the plan."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, Report, check, run
from cnc.boards.loopback import Loopback
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import Dwell, Held
from cnc.model.streams import PulseChunk
from cnc.session.run_pulses import Progress

PROGRAM = """G21 G90 G94
G0 X5 Y5
M3 S1000
G1 X40 F3000
G2 X40 Y25 I0 J10
G1 X5 Y20
G4 P0.25
G1 X5 Y5
G0 X0 Y0
M2
"""


def mill() -> Machine:
    each = Axis(steps_per_mm=100.0, max_velocity=200.0, max_acceleration=1500.0, max_jerk=40000.0)
    return Machine(axes={"x": each, "y": each, "z": each}, path=PathLimits(max_feed=150.0))


class Timed(Loopback):
    """Keeps the times of its pulses, and refuses pulses during a hold."""

    def __init__(self) -> None:
        super().__init__(3)
        self.times: list[np.ndarray] = []

    def send(self, chunk: PulseChunk) -> None:
        super().send(chunk)
        self.times.append(chunk.time_ns)

    @property
    def last_s(self) -> float:
        return float(self.times[-1][-1]) * 1e-9

    @property
    def held(self) -> list[float]:
        return [time * 1e-9 for time, block in self.commands if isinstance(block, Held)]


@pytest.fixture
def program(tmp_path: Path) -> Path:
    file = tmp_path / "p.nc"
    file.write_text(PROGRAM)
    return file


def scripted(
    program: Path, *script: tuple[float, Callable[[Control], None]]
) -> tuple[Report, Timed, list[Progress]]:
    """Run with an operator who acts at machine times, and resumes when the machine has come to
    rest.
    """
    control, board, reported, left = Control(), Timed(), [], list(script)

    def on_sent(sent: Progress) -> None:
        reported.append(sent)
        if sent.held:
            control.resume()
        while left and sent.time >= left[0][0]:
            left.pop(0)[1](control)

    return (
        run(program, mill(), board=board, control=control, callbacks=Callbacks(on_sent=on_sent)),
        board,
        reported,
    )


def test_holds_and_overrides_change_no_step(program):
    plain, straight, _ = scripted(program)
    assert plain.ok
    for k in range(12):
        at = plain.duration_s * (k + 0.5) / 12
        report, board, reported = scripted(
            program,
            (at, Control.hold),
            (at + 0.3, lambda control: control.override(40.0)),
            (at + 0.6, Control.hold),
            (at + 0.9, lambda control: control.override(200.0)),
        )
        assert report.ok
        assert board.position_steps.tolist() == straight.position_steps.tolist()
        assert board.steps_by_direction.tolist() == straight.steps_by_direction.tolist()
        assert report.steps == plain.steps
        assert report.stopped_at_line is None
        assert [sent.time for sent in reported if sent.held] == pytest.approx(board.held, abs=1e-8)
        assert board.held


def test_hold_is_fast_and_takes_no_machine_time(program):
    plain, _, _ = scripted(program)
    report, board, reported = scripted(program, (0.5, Control.hold))
    asked = next(sent.time for sent in reported if sent.time >= 0.5)
    # A slice, then acceleration let go of and a ramp from 50 mm/s to rest at the axes' limits.
    assert board.held[0] - asked <= 0.1 + 1.1 * (50 / 1500 + 1500 / 40000)
    assert report.duration_s - plain.duration_s < 0.3
    pulses = np.concatenate(board.times) * 1e-9
    around = pulses[np.abs(pulses - board.held[0]) < 0.05]
    assert np.diff(around).max() > 5 * np.diff(pulses[(pulses > 0.4) & (pulses < 0.5)]).max()


def test_stop_during_a_hold_is_an_operator_stop(program):
    control, board = Control(), Timed()

    def on_sent(sent: Progress) -> None:
        if sent.held:
            control.stop()
        elif sent.time > 0.5:
            control.hold()

    report = run(
        program, mill(), board=board, control=control, callbacks=Callbacks(on_sent=on_sent)
    )
    assert report.stopped_at_line is not None
    assert report.ok
    assert board.state == "stopped"
    assert report.duration_s == pytest.approx(board.held[0], abs=1e-6)


def test_hold_waits_without_polling(program):
    """Until the operator resumes from another thread, the run calls neither the board nor the
    operator.
    """
    control, board, resting, reported = Control(), Timed(), threading.Event(), []

    def on_sent(sent: Progress) -> None:
        reported.append(sent)
        if sent.held:
            resting.set()
        elif sent.time > 0.5 and not resting.is_set():
            control.hold()

    worker = threading.Thread(
        target=lambda: run(
            program, mill(), board=board, control=control, callbacks=Callbacks(on_sent=on_sent)
        )
    )
    worker.start()
    assert resting.wait(60)
    count, rows = len(reported), board.rows
    assert not worker.join(0.2)
    assert worker.is_alive()
    assert (len(reported), board.rows) == (count, rows)
    control.override(50.0)
    worker.join(0.1)
    assert worker.is_alive()
    control.resume()
    worker.join(60)
    assert not worker.is_alive()
    assert board.state == "idle"


def test_hold_resumed_before_rest(program):
    _, straight, _ = scripted(program)
    report, board, _ = scripted(program, (0.5, Control.hold), (0.501, Control.resume))
    assert report.ok
    assert board.held == []
    assert board.position_steps.tolist() == straight.position_steps.tolist()


def test_duration_equals_the_time_played(program):
    report, board, reported = scripted(program)
    dwells = [block for _, block in board.commands if isinstance(block, Dwell)]
    assert sum(dwell.seconds for dwell in dwells) == 0.25
    # Pulses are in whole ns. The last step of a ramp to rest comes shortly before its end:
    # half a BLU before it at a jerk
    # of 40000 mm/s^3.
    assert -1e-9 <= report.duration_s - board.last_s <= (6 * 0.01 / 40000) ** (1 / 3)
    assert reported[-1].time == pytest.approx(report.duration_s, abs=1e-9)
    assert check(program, mill()).duration_s == pytest.approx(report.duration_s, rel=1e-9)
    ends = [time * 1e-9 for time, block in board.commands]
    assert ends == sorted(ends)
    assert ends[-1] == pytest.approx(report.duration_s, abs=1e-8)


@pytest.mark.parametrize("percent", [10.0, 50.0, 200.0])
def test_override_does_not_scale_traverses(program, percent):
    whole = check(program, mill())
    other = check(program, mill(), control=Control(percent))
    assert (other.duration_s > whole.duration_s) == (percent < 100.0)
    assert other.steps == whole.steps
    on_board = run(program, mill(), board=Timed(), control=Control(percent))
    assert on_board.duration_s == pytest.approx(other.duration_s, rel=1e-6)


def test_traverses_reach_the_limits_of_the_axes(tmp_path):
    """X limits the speed of this G0, and Y its acceleration and jerk.

    The machine's largest feed has no effect.
    """
    fast = Axis(steps_per_mm=10.0, max_velocity=300.0, max_acceleration=5000.0, max_jerk=200000.0)
    heavy = Axis(steps_per_mm=10.0, max_velocity=400.0, max_acceleration=1000.0, max_jerk=20000.0)
    machine = Machine(axes={"x": fast, "y": heavy}, path=PathLimits(max_feed=20.0))
    file = tmp_path / "p.nc"
    for x, y in ((400.0, 300.0), (400.0, 0.0), (0.0, 300.0), (300.0, 30.0)):
        file.write_text(f"G21 G90\nG0 X{x} Y{y}\nM2\n")
        length = float(np.hypot(x, y))
        cx, cy = x / length, y / length
        with np.errstate(divide="ignore"):
            v, a, j = (
                min(np.divide(p, cx), np.divide(q, cy))
                for p, q in ((300.0, 400.0), (5000.0, 1000.0), (200000.0, 20000.0))
            )
        expected = length / v + v / a + a / j
        assert check(file, machine).duration_s == pytest.approx(expected, rel=1e-3)

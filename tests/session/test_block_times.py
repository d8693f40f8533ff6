"""Inverse time feed (G93): a block takes 1/F minutes, or a note says how long it takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cnc.api import Outputs, RunOptions, check
from cnc.machine.models import Axis, Board, Machine, PathLimits
from tests.support.soak import share


def machine(period: float = 1e-3) -> Machine:
    axis = Axis(steps_per_mm=100.0, max_velocity=200.0, max_acceleration=2000.0, max_jerk=40_000.0)
    axes = dict.fromkeys("xyza", axis)
    path = PathLimits(period=period, max_feed=150.0)
    return Machine(axes=axes, path=path, board=Board(max_step_rate=1e9))


def checked(tmp_path: Path, program: str):
    """Return the notes by line, and the times by line in the trace (s)."""
    file, trace = tmp_path / "part.ngc", tmp_path / "trace.npz"
    file.write_text(program)
    report = check(
        file, machine(), RunOptions(dialect="linuxcnc", outputs=Outputs(trace=str(trace)))
    )
    assert report.ok, report.faults
    notes = {each.line: each for each in report.warnings if each.code == "block-time"}
    rows = np.load(trace)
    lines, counts = np.unique(rows["line"][:-1], return_counts=True)
    return notes, dict(zip(lines.tolist(), (counts * 1e-3).tolist(), strict=True))


def test_blocks_at_a_constant_speed_take_their_time(tmp_path: Path) -> None:
    """Blocks of one speed in the middle of a straight path, with and without a rotary axis."""
    moves = "\n".join(f"G1 X{2.5 * k:.3f} A{3 * k} F240" for k in range(1, 21))
    notes, times = checked(tmp_path, f"G21 G90 G93 G61\n{moves}\nM2\n")
    for line in range(3, 21):
        assert line not in notes
        assert times[line] == pytest.approx(0.25, abs=1.5e-3)
    assert {2, 21} == set(notes)
    assert notes[2].severity == "note"
    assert "0.2500 s" in notes[2].message


def test_a_slower_limit_is_reported(tmp_path: Path) -> None:
    """X would have to move at 300 mm/s; the path's limit is 150 mm/s."""
    notes, times = checked(tmp_path, "G21 G90 G93\nG1 X600 F30\nM2\n")
    assert times[2] > 4.0
    assert f"takes {times[2]:.1f}"[:9] in notes[2].message
    assert "2.0000 s" in notes[2].message


def test_moves_per_minute_have_no_notes(tmp_path: Path) -> None:
    notes, _ = checked(tmp_path, "G21 G90\nG1 X10 F600\nG1 Y10\nM2\n")
    assert not notes


@pytest.mark.parametrize("mode", ["G61", "G64", "G64 P0.05", "G64 P0.5", "G64 P3"])
@pytest.mark.parametrize("seed", range(share(40, 1)))
def test_every_block_takes_its_time_or_has_a_note(seed: int, mode: str, tmp_path: Path) -> None:
    fresh = share(int(np.random.default_rng().integers(2**32)), 1)
    rng = np.random.default_rng([fresh, seed])
    here, lines, wanted = np.zeros(4), [f"G21 G90 G93 {mode}"], {}
    for number in range(2, 18):
        kind = rng.integers(4)
        step = rng.normal(0.0, 10.0, 4) * (rng.random(4) < 0.6)
        if kind == 3:
            seconds = rng.uniform(0.2, 2.0)
            radius = rng.uniform(1.0, 20.0)
            words = f"G3 X{here[0]:.3f} Y{here[1]:.3f} I{radius:.3f} J0 A{here[3] + step[3]:.3f}"
            here[3] += step[3]
        else:
            here = here + step
            seconds = 10 ** rng.uniform(-1.5, 0.5)
            words = "G1 " + " ".join(f"{a}{v:.3f}" for a, v in zip("XYZA", here, strict=True))
        here = here.round(3)
        lines.append(f"{words} F{60.0 / seconds:.6f}")
        wanted[number] = 60.0 / float(f"{60.0 / seconds:.6f}")
    notes, times = checked(tmp_path, "\n".join([*lines, "M2", ""]))
    for line, taken in times.items():
        due = wanted[line]
        # rows count a time to a period
        if mode == "G61":
            assert taken >= due - 1.1e-3, (fresh, seed, line)
        if line not in notes:
            assert abs(taken - due) <= 2.1e-3, (fresh, seed, line)


def test_a_block_that_a_blend_shortens_is_reported(tmp_path: Path) -> None:
    """The blends at both ends of the second block take a part of it, and the feed stays."""
    moves = "G1 X20 F30\nG1 Y20 F30\nG1 X0 F30"
    exact, _ = checked(tmp_path, f"G21 G90 G93 G61\n{moves}\nM2\n")
    blended, times = checked(tmp_path, f"G21 G90 G93 G64 P2\n{moves}\nM2\n")
    assert times[3] < 1.9
    assert f"takes {times[3]:.2f}"[:9] in blended[3].message
    assert "F is 2.0000 s" in blended[3].message
    assert "G64" in str(blended[3].hint)
    assert "smaller F" in str(exact[3].hint)

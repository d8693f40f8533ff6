"""Step pulses as .npz and .vcd: names, types, edges and pulse widths."""

import re

import numpy as np

from cnc.machine.load import load_machine
from cnc.model.streams import PulseChunk
from cnc.planner.joints import Joints
from cnc.report.pulses import pulse_writer

MACHINE = load_machine("paper-nurbs")


def pulses(times, steps, line=3) -> PulseChunk:
    return PulseChunk(
        np.array(times, np.int64),
        np.array(steps, np.int8).reshape(-1, 3),
        np.full(len(times), line, np.int32),
    )


def test_pulses_as_arrays(tmp_path):
    file = tmp_path / "p.npz"
    writer = pulse_writer(str(file), Joints(MACHINE), np.array([5, 6, 7]))
    writer.write(pulses([10, 20], [[1, 0, 0], [0, -1, 1]]))
    writer.write(pulses([30], [[1, 1, 1]], line=4))
    writer.close()
    with np.load(file) as found:
        assert set(found) == {"time_ns", "step", "line", "axes", "steps_per_mm", "origin_steps"}
        assert found["time_ns"].tolist() == [10, 20, 30]
        assert found["time_ns"].dtype == np.int64
        assert found["step"].tolist() == [[1, 0, 0], [0, -1, 1], [1, 1, 1]]
        assert found["step"].dtype == np.int8
        assert found["line"].tolist() == [3, 3, 4]
        assert found["line"].dtype == np.int32
        assert found["steps_per_mm"].tolist() == [1000.0] * 3
        assert found["origin_steps"].tolist() == [5, 6, 7]


def read_vcd(text: str) -> tuple[dict[str, str], list[tuple[int, str, str]]]:
    """Return names by identifier, and (time, identifier, value) of each change."""
    names = {
        match[2]: match[3]
        for match in re.finditer(r"\$var (?:wire 1|integer (32)) (\S+) (\S+) \$end", text)
    }
    changes, time = [], 0
    for line in text.split("$end\n")[-1].splitlines():
        if line.startswith("#"):
            assert int(line[1:]) > time
            time = int(line[1:])
        elif line.startswith("b"):
            changes.append((time, line.split()[1], line.split()[0][1:]))
        else:
            changes.append((time, line[1:], line[0]))
    return names, changes


def test_pulses_as_value_changes(tmp_path):
    file = tmp_path / "p.vcd"
    writer = pulse_writer(str(file), Joints(MACHINE), np.zeros(3, np.int64))
    writer.write(pulses([5000, 5500], [[1, 0, 0], [0, -1, 0]]))
    writer.write(pulses([9000, 9000], [[1, 0, 0], [0, 0, 1]], line=4))
    writer.close()
    names, changes = read_vcd(file.read_text())
    assert names == {
        "s0": "x_step",
        "d0": "x_dir",
        "s1": "y_step",
        "d1": "y_dir",
        "s2": "z_step",
        "d2": "z_dir",
        "l": "line",
    }
    assert changes == [
        (5000, "l", "11"),
        (5000, "d0", "1"),
        (5000, "s0", "1"),
        (5500, "s1", "1"),
        (6000, "s0", "0"),
        (6500, "s1", "0"),
        (9000, "l", "100"),
        (9000, "s0", "1"),
        (9000, "d2", "1"),
        (9000, "s2", "1"),
        (10000, "s0", "0"),
        (10000, "s2", "0"),
    ]


def test_pulses_are_narrower_at_a_high_step_rate(tmp_path):
    board = MACHINE.board.model_copy(update={"max_step_rate": 2e6})
    writer = pulse_writer(
        str(tmp_path / "p.vcd"),
        Joints(MACHINE.model_copy(update={"board": board})),
        np.zeros(3, np.int64),
    )
    writer.write(pulses([500, 1000], [[1, 0, 0], [1, 0, 0]]))
    writer.close()
    edges = [
        (time, value)
        for time, name, value in read_vcd((tmp_path / "p.vcd").read_text())[1]
        if name == "s0"
    ]
    assert edges == [(500, "1"), (750, "0"), (1000, "1"), (1250, "0")]

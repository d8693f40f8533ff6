"""Computing time by commit: the file, the comparison, and a measurement of a small program."""

import json
import math
import subprocess
import sys

import pytest

from benchmarks import history
from benchmarks.history import Entry, Figure, compared, joined, read, recorded, write
from tests.support.paths import ROOT

OLD = Entry(
    "a" * 40, "2026-11-01", 0.2, {"arcs": Figure(1.0, 5.0, 30.0), "holes": Figure(2.0, 9.5, 99.5)}
)


def test_what_is_written_is_read(tmp_path):
    file = tmp_path / "history.json"
    assert read(file) == []
    new = Entry("b" * 40, "2026-11-02", 0.25, {"arcs": Figure(1.25, 5.5, 30.0)})
    write([OLD, new], file)
    assert read(file) == [OLD, new]
    again = new._replace(speed_s=0.3)
    assert recorded([OLD, new], again) == [OLD, again]


@pytest.mark.parametrize(("ratio", "slower"), [(1.09, False), (1.11, True), (0.5, False)])
def test_a_figure_that_takes_a_tenth_longer_is_marked(ratio, slower):
    """By its work, which the speed of the machine does not change."""
    now = Entry("b" * 40, "2026-11-02", 0.4, {"arcs": Figure(2.0, 5.0 * ratio, 33.0)})
    _, line = compared(now, OLD)
    assert f"CPU {ratio:5.2f}, motion 1.10000" in line
    assert ("SLOWER" in line) == slower


def test_without_a_commit_before_the_figures_stand_alone():
    header, *rows = compared(OLD, None)
    assert "beside" not in header
    assert [row.split()[0] for row in rows] == ["arcs", "holes"]
    assert "motion s" in header


def test_the_least_times_and_the_median_of_the_work_count():
    rounds = [
        {"speed_s": 0.3, "figures": {"arcs": [1.0, 4.0, 30.0]}},
        {"speed_s": 0.2, "figures": {"arcs": [1.5, 7.0, 30.0]}},
        {"speed_s": 0.4, "figures": {"arcs": [1.1, 5.0, 30.0]}},
    ]
    entry = joined(rounds, "c" * 40)
    assert (entry.commit, entry.speed_s) == ("c" * 40, 0.2)
    assert entry.figures == {"arcs": Figure(1.0, 5.0, 30.0)}


def test_a_measurement_has_a_time_and_a_motion(monkeypatch):
    """A square of 10 mm takes longer than its way at the feed."""
    square = (lambda: iter(["G21 G90 G61\nF600\nG1 X10\nY10\nX0\nY0\nM2"]), "axes")
    monkeypatch.setattr(history, "PROGRAMS", {"square": square})
    monkeypatch.setattr(history, "_speed", lambda: lambda: 0.5)
    measured = json.loads(json.dumps(history.measure()))
    assert measured["speed_s"] == 0.5
    cpu, work, motion = measured["figures"]["square"]
    assert work == pytest.approx(cpu / 0.5)
    assert cpu > 0.0
    assert 4.0 < motion < 6.0


def test_the_programs_are_right_and_the_file_names_them():
    """The newest entry has each program of the table, with the motion that a plan had then."""
    for lines, _ in history.PROGRAMS.values():
        assert list(lines()) == list(lines())
    newest = read()[-1]
    assert set(newest.figures) == set(history.PROGRAMS)
    assert all(figure.cpu_s > 0.0 and figure.motion_s > 1.0 for figure in newest.figures.values())
    assert math.isfinite(newest.speed_s)


def test_a_change_that_is_not_committed_is_not_recorded(monkeypatch, capsys):
    monkeypatch.setattr(history, "_git", lambda *words: " M cnc/api.py")
    monkeypatch.setattr(sys, "argv", ["history", "--record"])
    with pytest.raises(SystemExit) as end:
        history.main()
    assert end.value.code == 2
    assert "commit the changes first" in capsys.readouterr().err


def test_its_help_needs_no_kernel():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.history", "--help"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "--beside" in done.stdout

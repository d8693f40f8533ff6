"""Comparison of two programs: the largest distance of their toolpaths, its place, and times."""

import io
import json
import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc import cli
from cnc.api import plan, start_position
from cnc.compare.programs import LARGE, Recorder, Track, compare, farthest, hunks
from cnc.machine.load import load_machine
from cnc.planner.plan import PlanChunk
from cnc.pulses.sampled import Sampled
from tests.support.paths import ROOT
from tests.support.soak import share

MACHINE = load_machine("default")
HEAD = "G21 G90 G94 G17 G61 F1200\n"


@pytest.fixture
def difference(tmp_path):
    """Return a function: the difference of two programs."""

    def look(one: str, other: str):
        for name, text in ("a.nc", one), ("b.nc", other):
            (tmp_path / name).write_text(HEAD + text + "\nM2\n")
        return compare(tmp_path / "a.nc", tmp_path / "b.nc", (MACHINE, MACHINE))

    return look


SQUARE = "G1 X40\nG1 Y40\nG1 X0\nG1 Y0"


@pytest.mark.parametrize(
    ("one", "other", "distance", "lines"),
    [
        (SQUARE, SQUARE, 0.0, None),
        (SQUARE, "(a comment)\nN10 x40. f1200\ny 40\n g1 x0 y40\n\ny0", 0.0, None),
        (SQUARE, "G91 G1 X40\nG1 Y40\nG1 X-40\nG1 Y-40", 0.0, None),
        (
            SQUARE,
            "G1 X20\nG1 X40\nG1 Y10\nG1 Y40\nG1 X0\nG1 Y0",
            0.0,
            None,
        ),  # further points on a straight line
        (SQUARE, SQUARE + "\nF100", 0.0, None),
        ("", "", 0.0, None),
        ("M3 S9", "G4 P1", 0.0, None),
        (SQUARE, "G1 X40\nG1 Y40.5\nG1 X0\nG1 Y0", 0.5, (4, 4)),  # along the whole edge
        (SQUARE, "G1 X40\nG1 Y40\nG1 X-3\nG1 X0\nG1 Y0", 3.0, (4, 4)),
        (SQUARE, "G1 X40\nG1 Y40\nG1 X0\nG1 Y0\nG1 Z-7", 7.0, (5, 6)),
        (SQUARE, "G1 X40\nG1 Y40\nG1 X0", 40.0, (5, 4)),
        (SQUARE, "G1 Y40\nG1 X40\nG1 Y0\nG1 X0", 40.0, None),  # in the opposite direction
        (SQUARE + "\nG0 Z5\n" + SQUARE, SQUARE + "\nG0 Z9\n" + SQUARE, 4.0, None),
        ("", "G0 X3 Y4", 5.0, (0, 2)),
        ("G2 X20 I10", "G2 X10 Y10 I10\nX20 Y0 J-10", 0.0, None),
        ("G2 X20 I10", "G2 X20 R10", 0.0, None),
        ("G2 X20 I10", "G3 X20 I10", 20.0, (2, 2)),
        ("G2 X20 I10", "G1 X20", 10.0, (2, 2)),
        ("G2 X40 Y40 R50", "G2 X40 Y40 R51", None, (2, 2)),
        ("G64 P0.5\nG1 X40\nG1 Y40", "G1 X40\nG1 Y40", 0.5, None),
    ],
)
def test_distance_and_lines(difference, one, other, distance, lines):
    found = difference(one, other)
    if distance is None:
        # The heights of two arcs over one chord have the largest distance.
        heights = [r - math.sqrt(r * r - 800.0) for r in (50.0, 51.0)]
        distance = heights[0] - heights[1]
    assert found.distance == pytest.approx(distance, abs=5e-4, rel=2e-3)
    assert found.same_path == (distance == 0.0)
    if lines is not None:
        assert tuple(place.line for place in found.places) == lines


def test_times_and_lengths(difference):
    found = difference("G1 X40", "G1 X40 F600")
    one, other = found.reports
    assert found.same_path
    assert (one.path_length_mm, other.path_length_mm) == (40.0, 40.0)
    assert other.duration_s == pytest.approx(4.0, rel=0.05)
    assert one.duration_s < 0.6 * other.duration_s
    shown = list(found.lines())
    assert shown[0] == "path    the same"
    assert shown[2].startswith("time    2.0")


def test_an_additional_pass_has_the_largest_distance(difference):
    """The rest is the same, although its line numbers differ."""
    passes = [f"G0 Y{y}\nG1 Z-1\nG1 X30\nG0 Z2\nG0 X0" for y in range(10)]
    more = [*passes[:4], "G0 Y3.5\nG1 Z-1\nG1 X30\nG1 X33\nG0 Z2\nG0 X0", *passes[4:]]
    found = difference("\n".join(passes), "\n".join(more))
    assert found.places[1].line in range(22, 28)
    assert found.at["y"] in (3.0, 3.5, 4.0) or found.at["x"] > 29.0


@settings(max_examples=share(200, 6))
@given(st.integers(0, 30), st.floats(0.01, 3.0), st.integers(0, 2))
def test_one_moved_point(tmp_path_factory, index, far, axis):
    """One point of a spiral of straight moves is displaced by the distance."""
    folder = tmp_path_factory.mktemp("moved")
    points = [[k + 10.0 + 5.0 * math.cos(k), 20.0 + 5.0 * math.sin(k), 0.1 * k] for k in range(31)]
    for name in "a.nc", "b.nc":
        lines = [
            " ".join(f"{letter}{value:.6f}" for letter, value in zip("XYZ", point, strict=True))
            for point in points
        ]
        (folder / name).write_text(HEAD + "G1 " + "\n".join(lines) + "\nM2\n")
        points[index][axis] += far
    found = compare(folder / "a.nc", folder / "b.nc", (MACHINE, MACHINE))
    assert 0.3 * far < found.distance <= far + 1e-3
    assert abs(found.places[0].line - (index + 2)) <= 1
    assert abs(found.places[1].line - (index + 2)) <= 1


def track_of(points: np.ndarray) -> Track:
    count = np.arange(len(points))
    return Track(points, count, 0 * count, ("",))


POLYGONS = st.lists(st.tuples(*[st.integers(-5, 5).map(float)] * 2), min_size=1, max_size=12).map(
    lambda each: np.array([(0.0, 0.0), *each])
)


def hausdorff(a: np.ndarray, b: np.ndarray) -> float:
    """Return the Hausdorff distance, a lower bound of any distance of two tracks."""
    dense = [
        np.concatenate([np.linspace(p, q, 60) for p, q in pairwise(each)] or [each])
        for each in (a, b)
    ]
    apart = np.linalg.norm(dense[0][:, None] - dense[1][None], axis=2)
    return float(max(apart.min(axis=1).max(), apart.min(axis=0).max()))


@settings(max_examples=share(300, 11))
@given(POLYGONS, POLYGONS)
def test_the_distance_is_at_least_the_hausdorff_distance(a, b):
    found, back = farthest(track_of(a), track_of(b)), farthest(track_of(b), track_of(a))
    assert found.distance >= hausdorff(a, b) - 0.25
    assert back.distance >= hausdorff(a, b) - 0.25
    assert found.distance <= np.abs(np.concatenate((a, b))).max() * 3.0
    assert farthest(track_of(a), track_of(a)).distance == 0.0


@given(POLYGONS, POLYGONS)
def test_points_outside_of_hunks_are_common(a, b):
    """Points outside of the hunks are equal and in order; each hunk begins at a common point."""
    i = j = 0
    for hunk in hunks(a, b):
        assert hunk.a0 - i == hunk.b0 - j >= 0
        assert a[i : hunk.a0 + 1].tolist() == b[j : hunk.b0 + 1].tolist()
        i, j = hunk.a1, hunk.b1
        assert not hunk.closed or a[i].tolist() == b[j].tolist()
    if i < len(a) - 1 or j < len(b) - 1:
        assert a[i:].tolist() == b[j:].tolist()


def test_large_tracks_are_measured_in_parts():
    """Two samplings of one curve have only the first point in common; one has a bulge."""
    t = np.linspace(0.0, 60.0, 5 * LARGE), np.linspace(0.0, 60.0, 4 * LARGE + 7)
    curves = [np.stack((each * np.cos(each), each * np.sin(each)), axis=1) for each in t]
    assert (
        farthest(track_of(curves[0]), track_of(curves[1])).distance < 2e-2
    )  # chords of 1.2 mm on the outermost turn, radius 60: about 3 um
    curves[1][2000] *= 1.01
    found = farthest(track_of(curves[0]), track_of(curves[1]))
    assert found.distance == pytest.approx(0.01 * t[1][2000], rel=0.1)
    assert abs(found.second - 2000) <= 1


@pytest.mark.parametrize(
    "name", share(["pocket", "engraving", "bezier", "trident"], ["engraving", "trident"])
)
def test_a_track_is_the_toolpath(name):
    """Every sample of the motion lies on the track."""
    machine = load_machine("paper-nurbs" if name == "trident" else "default")
    recorder, sampler = Recorder(start_position(machine)), Sampled(0.01, start_position(machine))
    samples = []
    for item in plan(ROOT / "programs" / f"{name}.nc", machine):
        if isinstance(item, PlanChunk):
            recorder.add(item)
            samples += [chunk.position for chunk in sampler.samples(item)]
    track = recorder.track()
    starts, steps = track.points[:-1], np.diff(track.points, axis=0)
    for point in np.concatenate(samples)[:: 1 + len(np.concatenate(samples)) // 400]:
        share = np.clip(
            ((point - starts) * steps).sum(axis=1)
            / np.maximum((steps * steps).sum(axis=1), 1e-300),
            0.0,
            1.0,
        )
        assert np.linalg.norm(starts + share[:, None] * steps - point, axis=1).min() < 1e-3
    assert (
        np.linalg.norm(steps, axis=1).sum()
        > 0.999 * np.linalg.norm(np.diff(np.concatenate(samples), axis=0), axis=1).sum()
    )


def test_a_diff_holds_the_travel_of_the_machine(tmp_path, capfd):
    files = [str(tmp_path / name) for name in ("a.nc", "b.nc")]
    for x, name in enumerate(files, start=500):
        Path(name).write_text(f"{HEAD}G0 X{x}\nM2\n")
    assert cli.exit_code(["diff", *files]) == 1
    assert "soft-limit" in capfd.readouterr().err


def test_diff_on_the_command_line(tmp_path, capfd, monkeypatch):
    one, other, bad = (str(tmp_path / name) for name in ("a.nc", "b.nc", "bad.nc"))
    Path(one).write_text(HEAD + SQUARE + "\nM2\n")
    Path(other).write_text(HEAD + SQUARE.replace("G1 Y40", "G1 Y41") + "\nM2\n")
    Path(bad).write_text("G1 X5\n")
    assert cli.exit_code(["diff", one, other]) == 0
    out = capfd.readouterr().out.splitlines()
    assert out[0].startswith("path    at most 1 mm apart, at X")
    assert f"{one}:4, {other}:4" in out[0]
    assert cli.exit_code(["diff", one, other, "--json", "-"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert (found["programs"], found["lines"]) == ([one, other], [4, 4])
    assert found["distance_mm"] == pytest.approx(1.0)
    for pair in (bad, one), (one, bad):
        assert cli.exit_code(["diff", *pair]) == 1
        assert f"{bad}:1:1: feed-missing" in capfd.readouterr().err
    assert cli.exit_code(["diff", one, one + "x"]) == 2
    assert cli.exit_code(["diff", one, other, "--json", one]) == 2
    assert cli.exit_code(["diff", one]) == 2
    capfd.readouterr()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(Path(one).read_bytes())))
    assert cli.exit_code(["diff", "-", other]) == 0
    assert "<stdin>:4" in capfd.readouterr().out
    assert cli.exit_code(["diff", "-", "-"]) == 2

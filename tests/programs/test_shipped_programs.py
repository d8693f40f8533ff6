"""The shipped programs: the promises of their comments, and the generated program."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline

from cnc.gcode.core.program import interpret
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import (
    ArcFeed,
    Coolant,
    End,
    NurbsFeed,
    Polyline,
    Probe,
    Spindle,
    SpindleSync,
    Tool,
)
from tests.support.paths import ROOT

FOLDER = ROOT / "programs"
PROGRAMS = sorted(FOLDER.glob("*.nc"))
SYMMETRIC = [(10, 0), (20, 20), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0)]
AS_PRINTED = [(10, 10), (20, 10), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0)]


def blocks(file: Path) -> list:
    return list(interpret(Text.of_file(file, str(file))))


def of(kind: type, file: str) -> list:
    return [block for block in blocks(FOLDER / file) if isinstance(block, kind)]


def test_every_family_of_blocks_has_a_program():
    assert {file.name for file in PROGRAMS} >= {
        "trident.nc",
        "trident-as-printed.nc",
        "fanuc-nurbs.nc",
        "bezier.nc",
        "compensation.nc",
        "drilling.nc",
        "ngc-nurbs.nc",
        "siemens-bspline.nc",
        "engraving.nc",
        "pocket.nc",
        "probing.nc",
        "thread-mill.nc",
        "turned-thread.nc",
        "finishing.nc",
    }


@pytest.mark.parametrize("file", PROGRAMS, ids=lambda file: file.name)
def test_programs_end_with_the_spindle_off(file):
    found = blocks(file)
    assert isinstance(found[-1], End)
    states = [block.state for block in found if isinstance(block, Spindle)]
    assert not states or states[-1] == "off"
    floods = [block.flood for block in found if isinstance(block, Coolant)]
    assert not floods or not floods[-1]


@pytest.mark.parametrize(
    ("file", "points"), [("trident.nc", SYMMETRIC), ("trident-as-printed.nc", AS_PRINTED)]
)
def test_the_tridents_are_those_of_the_paper(file, points):
    (curve,) = of(NurbsFeed, file)
    assert curve.degree == 3
    assert curve.knots.tolist() == [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]
    assert curve.control_points[:, :2].tolist() == [list(map(float, point)) for point in points]
    assert curve.weights.tolist() == [1.0] * 7
    assert curve.feed == 300.0


def test_fanuc_nurbs_has_a_full_circle_and_a_curve_in_space():
    circle, wave = of(NurbsFeed, "fanuc-nurbs.nc")
    assert (circle.degree, len(circle.knots), wave.degree, len(wave.knots)) == (2, 12, 3, 12)
    assert (
        circle.control_points[0].tolist()
        == circle.control_points[-1].tolist()
        == [80.0, 50.0, -1.0]
    )
    assert circle.weights[1] == np.sqrt(0.5)
    assert len(set(wave.control_points[:, 2])) > 3


def distance_from(center: tuple[float, float], curve: NurbsFeed) -> np.ndarray:
    """Return the distances of points along a curve from a point, in XY."""
    u = np.linspace(curve.knots[0], curve.knots[-1], 101)
    top = BSpline(curve.knots, curve.control_points * curve.weights[:, None], curve.degree)(u)
    points = top / BSpline(curve.knots, curve.weights, curve.degree)(u)[:, None]
    return np.hypot(points[:, 0] - center[0], points[:, 1] - center[1])


def test_the_disc_of_cubics_is_round():
    curves = of(NurbsFeed, "bezier.nc")
    off = np.abs(np.array([distance_from((60.0, 60.0), curve) for curve in curves[:4]]) - 30.0)
    assert 0.008 < off.max() < 0.0083
    assert [curve.degree for curve in curves] == [3] * 8 + [2, 2, 3, 3, 2]
    assert curves[-1].control_points[:, 1].tolist() == [130.0] * 3
    assert curves[-2].control_points[:, 2].min() == -6.0


def test_the_circle_of_ngc_nurbs_is_exact():
    documented, *quarters, wave = of(NurbsFeed, "ngc-nurbs.nc")
    assert documented.weights.tolist() == [1, 1, 1, 1, 2]
    for quarter in quarters:
        assert distance_from((150.0, 50.0), quarter) == pytest.approx(np.full(101, 30.0), abs=1e-13)
    assert quarters[-1].control_points[-1].tolist() == quarters[0].control_points[0].tolist()
    assert (wave.degree, len(wave.control_points)) == (3, 8)


def test_the_b_splines_have_their_knots_and_weights():
    plain, weighted, square, space = of(NurbsFeed, "siemens-bspline.nc")
    assert plain.control_points.tolist() == weighted.control_points.tolist()
    assert (plain.weights.tolist(), weighted.weights.tolist()) == ([1] * 6, [1, 2, 1, 0.5, 1, 1])
    assert square.degree == 2
    assert square.control_points[0].tolist() == square.control_points[-1].tolist()
    assert space.knots.tolist() == pytest.approx([0, 0, 0, 0, 0.2, 0.4, 0.7, 0.7, 1, 1, 1, 1])


def test_the_thread_has_turns_in_one_and_in_many_blocks():
    turns = [arc.turns for arc in of(ArcFeed, "thread-mill.nc")]
    assert 6.0 in turns
    assert turns.count(1.0) >= 6
    assert of(Tool, "thread-mill.nc")[0].number == 7


def test_the_finishing_pass_equals_the_output_of_its_script(tmp_path):
    script = runpy.run_path(str(FOLDER / "make_finishing.py"))
    assert "\n".join(script["lines"]()) + "\n" == (FOLDER / "finishing.nc").read_text()


def test_the_finishing_pass_has_20_000_short_moves():
    moves = of(Polyline, "finishing.nc")
    points = np.vstack([move.points for move in moves])
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.count_nonzero(lengths < 0.5) == 20_000
    assert 0.15 <= np.median(lengths) < 0.16


def test_the_drilled_holes():
    """Six on a circle of 40 mm and five in a row, each of them centred, drilled, and tapped or
    reamed.
    """
    deepest: dict[tuple[float, float], list[float]] = {}
    for run in of(Polyline, "drilling.nc"):
        for point in run.points[~np.isnan(run.feeds)]:
            place = (round(point[0] - 60, 6), round(point[1] - 60, 6))
            deepest.setdefault(place, []).append(round(point[2], 6))
    circle = {place for place in deepest if np.hypot(*place) == pytest.approx(40)}
    row = {(60.0, -40.0 + 20 * step) for step in range(5)}
    assert len(circle) == 6 and deepest.keys() == circle | row
    assert {min(deepest[place]) for place in circle} == {-24}
    assert {min(deepest[place]) for place in row} == {-12}
    taps = [block for block in of(Spindle, "drilling.nc") if block.state == "ccw"]
    assert len(taps) == 5


def test_probes_find_the_top_and_the_side():
    probes = of(Probe, "probing.nc")
    assert [probe.must for probe in probes] == [True, True, False, True, True]
    assert [probe.feed * 60 for probe in probes] == [300, 30, 300, 300, 30]


def test_the_turned_thread():
    """M20 x 1.5: the tool ends 0.92 mm inside the radius of 10, every pass at 1.5 mm a turn along
    Z.
    """
    assert {block.pitch for block in of(SpindleSync, "turned-thread.nc")} == {0.0, 1.0, 1.5}
    feeds = np.concatenate([run.feeds for run in of(Polyline, "turned-thread.nc")])
    assert np.nanmax(feeds) == pytest.approx(15.0 * np.hypot(1.5, 0.92) / 1.5)
    straight = [
        (point[0], feed)
        for run in of(Polyline, "turned-thread.nc")
        for point, feed, line in zip(run.points, run.feeds, run.lines, strict=True)
        if feed == pytest.approx(1.5 * 10) and line == 8
    ]
    assert min(x for x, _ in straight) == pytest.approx(9.08)
    assert sum(x == pytest.approx(9.08) for x, _ in straight) == 3

"""The shipped programs: what their comments promise, and that the generated one is what its script writes."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from cnc.canon import ArcFeed, Coolant, End, NurbsFeed, Polyline, Spindle, Tool
from cnc.gcode.program import interpret
from cnc.gcode.text import Text

FOLDER = Path(__file__).parents[2] / "programs"
PROGRAMS = sorted(FOLDER.glob("*.nc"))
SYMMETRIC = [(10, 0), (20, 20), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0)]
AS_PRINTED = [(10, 10), (20, 10), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0)]


def blocks(file: Path) -> list:
    return list(interpret(Text.of_file(file, str(file))))


def of(kind: type, file: str) -> list:
    return [block for block in blocks(FOLDER / file) if isinstance(block, kind)]


def test_one_for_every_family():
    assert {file.name for file in PROGRAMS} >= {
        "trident.nc",
        "trident-as-printed.nc",
        "fanuc-nurbs.nc",
        "engraving.nc",
        "pocket.nc",
        "thread-mill.nc",
        "finishing.nc",
    }


@pytest.mark.parametrize("file", PROGRAMS, ids=lambda file: file.name)
def test_it_ends_with_the_spindle_off(file):
    found = blocks(file)
    assert isinstance(found[-1], End)
    states = [block.state for block in found if isinstance(block, Spindle)]
    assert not states or states[-1] == "off"
    floods = [block.flood for block in found if isinstance(block, Coolant)]
    assert not floods or not floods[-1]


@pytest.mark.parametrize(("file", "points"), [("trident.nc", SYMMETRIC), ("trident-as-printed.nc", AS_PRINTED)])
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
    assert circle.control_points[0].tolist() == circle.control_points[-1].tolist() == [80.0, 50.0, -1.0]
    assert circle.weights[1] == np.sqrt(0.5)
    assert len(set(wave.control_points[:, 2])) > 3


def test_the_thread_has_turns_in_one_block_and_in_many():
    turns = [arc.turns for arc in of(ArcFeed, "thread-mill.nc")]
    assert 6.0 in turns
    assert turns.count(1.0) >= 6
    assert of(Tool, "thread-mill.nc")[0].number == 7


def test_the_finishing_pass_is_what_its_script_writes(tmp_path):
    script = runpy.run_path(str(FOLDER / "make_finishing.py"))
    assert "\n".join(script["lines"]()) + "\n" == (FOLDER / "finishing.nc").read_text()


def test_the_finishing_pass_has_20_000_short_moves():
    moves = of(Polyline, "finishing.nc")
    points = np.vstack([move.points for move in moves])
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert np.count_nonzero(lengths < 0.5) == 20_000
    assert 0.15 <= np.median(lengths) < 0.16

"""Programs of simple jobs: what they cut, by a reader of its own, and their check."""

import math
import re

import numpy as np
import pytest
from scipy.spatial import cKDTree

from cnc.api import check, from_text, parse
from cnc.model.blocks import ArcFeed, Dwell, Polyline, Spindle
from cnc.model.diagnostics import UsageError
from cnc.simple_jobs.lettering import letters, strokes
from cnc.simple_jobs.programs import KINDS, described, written
from tests.support.soak import share

CLOSE = 3e-4
"""Rounding of the numbers of a program, mm."""
SPACING = 0.05


def cut_places(text):
    """Return (n, 3) places of the tool below Z 0 while it feeds, and (n, 3) ends of traverses."""
    at, mode, cuts, traverses = np.array([0.0, 0.0, 50.0]), None, [], []
    for line in text.splitlines():
        line = re.sub(r"\(.*?\)", "", line)
        words = [(letter, float(value)) for letter, value in re.findall(r"([A-Z])(-?[\d.]+)", line)]
        codes = [value for letter, value in words if letter == "G"]
        mode = next((code for code in codes if code in (0.0, 1.0, 3.0)), mode)
        values = dict(words)
        if not set(values) & set("XYZ"):
            continue
        to = np.array([values.get(letter, at[k]) for k, letter in enumerate("XYZ")])
        if mode == 0.0:
            # A traverse goes up first or down last: no line of a job does both at once.
            traverses += [at, to]
        else:
            if mode == 3.0:
                centre = at[:2] + [values["I"], values["J"]]
                radius = math.dist(at[:2], centre)
                assert math.dist(to[:2], centre) == pytest.approx(radius, abs=CLOSE)
                first = math.atan2(*(at[:2] - centre)[::-1])
                turn = (math.atan2(*(to[:2] - centre)[::-1]) - first) % (2.0 * math.pi)
                turn = turn if turn > 1e-4 else turn + 2.0 * math.pi
                count = max(int(radius * turn / SPACING), 8)
                part = np.linspace(0.0, 1.0, count)
                angle = first + turn * part
                xy = centre + radius * np.column_stack((np.cos(angle), np.sin(angle)))
                way = np.column_stack((xy, at[2] + (to[2] - at[2]) * part))
            else:
                count = max(round(math.dist(at, to) / SPACING), 2)
                way = at + (to - at) * np.linspace(0.0, 1.0, count)[:, None]
            cuts.append(way)
        at = to
    assert at[2] > 0.0
    made = np.concatenate(cuts)
    return made[made[:, 2] <= 1e-9], np.array(traverses)


def area(kind, values):
    """Return the signed distance of (n, 2) places to the wall of the job, mm; negative inside."""
    if kind == "round-pocket":
        return lambda p: np.hypot(p[:, 0] - values["x"], p[:, 1] - values["y"]) - values["bore"] / 2
    if kind == "slot":
        begin = np.array([values["x"], values["y"]])
        way = np.array([values["x_end"], values["y_end"]]) - begin
        return lambda p: (
            np.hypot(
                *(p - begin - np.clip((p - begin) @ way / (way @ way), 0.0, 1.0)[:, None] * way).T
            )
            - values["width"] / 2
        )
    low = np.array([values["x"], values["y"]])
    high = low + [values["width"], values["length"]]
    return lambda p: np.maximum(low - p, p - high).max(axis=1)


def random_values(kind, rng):
    """Return parameters of a pocket, of all widths that its tool can cut."""
    tool = rng.uniform(1.0, 12.0)
    values = {
        "diameter": tool, "step_over": rng.uniform(5.0, 80.0), "depth": rng.uniform(0.3, 6.0),
        "step_down": rng.uniform(0.3, 4.0), "x": rng.uniform(-50, 50), "y": rng.uniform(-50, 50),
    }  # fmt: skip
    if kind == "round-pocket":
        return values | {"bore": tool * rng.uniform(1.11, 6.0)}
    if kind == "slot":
        angle, length = rng.uniform(0.0, 2.0 * math.pi), tool * rng.uniform(0.6, 8.0)
        ends = {"x_end": values["x"] + length * math.cos(angle)}
        ends["y_end"] = values["y"] + length * math.sin(angle)
        return values | ends | {"width": tool * rng.choice([1.0, rng.uniform(1.0, 4.0)])}
    sides = [tool * rng.uniform(1.6, 6.0), tool * rng.choice([1.0, rng.uniform(1.0, 6.0)])]
    return values | dict(zip(("width", "length"), rng.permutation(sides), strict=True))


@pytest.mark.parametrize("kind", ["rectangular-pocket", "round-pocket", "slot"])
@pytest.mark.parametrize("seed", range(share(12, 5)))
def test_a_pocket_is_cut_to_its_wall_and_no_further(kind, seed):
    """Each place of the floor is within a radius of the tool, and the tool within the wall."""
    rng = np.random.default_rng([seed, 20261129])
    values = random_values(kind, rng)
    places, traverses = cut_places(written(kind, values))
    radius, depth, distance = values["diameter"] / 2, values["depth"], area(kind, values)
    assert distance(places[:, :2]).max() <= -radius + CLOSE
    assert places[:, 2].min() == pytest.approx(-depth, abs=CLOSE)
    floor = places[places[:, 2] < -depth + CLOSE][:, :2]
    low, high = floor.min(axis=0) - radius, floor.max(axis=0) + radius
    tries = rng.uniform(low, high, (1500, 2))
    # A round tool leaves the corners of a rectangle: what it can reach is the area inside by its
    # radius, and a radius around it.
    if kind == "rectangular-pocket":
        corner = np.array([values["x"], values["y"]]) + radius
        end = corner + [values["width"] - 2 * radius, values["length"] - 2 * radius]
        inside = np.hypot(*(tries - np.clip(tries, corner, end)).T) < radius - SPACING
    else:
        inside = distance(tries) < -SPACING
    tries = tries[inside]
    assert len(tries) > 100
    nearest = cKDTree(floor).query(tries)[0]
    assert nearest.max() <= radius + SPACING
    # Each pass removes at most its depth, and a traverse is never in the material.
    ordered = np.unique(np.round(places[:, 2], 4))
    levels = math.ceil(depth / values["step_down"] - 1e-9)
    assert len(ordered) >= levels
    assert (traverses[:, 2] > 0.0).sum() >= len(traverses) - 1
    # A ramp is no steeper than 3 degrees, so a tool that cannot drill is not used as a drill.
    steps = np.diff(places, axis=0)
    down = steps[:, 2] < -1e-9
    slope = -steps[down, 2] / np.hypot(steps[down, 0], steps[down, 1])
    assert slope.max() <= math.tan(math.radians(3.0)) * 1.02


def test_surfacing_covers_the_area_and_goes_down_beside_it():
    for seed in range(8):
        rng = np.random.default_rng([seed, 7])
        values = {"width": rng.uniform(5, 90), "length": rng.uniform(5, 90), "x": 3.0, "y": -4.0}
        values |= {"diameter": rng.uniform(3, 30), "step_over": rng.uniform(20, 80), "depth": 0.7}
        values |= {"step_down": 0.3}
        places, _ = cut_places(written("surfacing", values))
        radius = values["diameter"] / 2
        floor = places[places[:, 2] < -0.7 + CLOSE][:, :2]
        tries = rng.uniform(
            [3.0, -4.0], [3.0 + values["width"], -4.0 + values["length"]], (1000, 2)
        )
        nearest = cKDTree(floor).query(tries)[0]
        assert nearest.max() <= radius + SPACING
        steps = np.diff(places, axis=0)
        straight_down = (steps[:, 2] < -1e-9) & (np.hypot(steps[:, 0], steps[:, 1]) < 1e-9)
        beside = area("surfacing", values)(places[:-1][straight_down][:, :2])
        assert (beside > radius).all()
        assert np.ptp(places[:, 2].round(4)) <= 0.7


def test_holes_stand_at_their_places():
    grid = {"columns": 3, "rows": 2, "pitch_x": 10.0, "pitch_y": 7.0, "x": 1.0, "y": 2.0}
    text = written("hole-grid", grid | {"depth": 4.0, "peck": 1.5})
    places = {(float(x), float(y)) for x, y in re.findall(r"X(-?[\d.]+) Y(-?[\d.]+)", text)}
    assert places == {(1.0 + 10 * k, 2.0 + 7 * n) for k in range(3) for n in range(2)}
    assert "G98 G83 Z-4 R1 Q1.5 F200" in text
    assert "G98 G81 Z-4 R1 F200" in written("hole-grid", {"depth": 4.0, "peck": 0.0})
    circle = written("hole-circle", {"holes": 8, "first": 22.5, "pitch_circle": 50.0})
    for k, (x, y) in enumerate(re.findall(r"X(-?[\d.]+) Y(-?[\d.]+)", circle)):
        place = 25.0 * np.exp(1j * math.radians(22.5 + 45.0 * k))
        assert (float(x), float(y)) == pytest.approx((place.real, place.imag), abs=CLOSE)


def test_a_text_has_its_height_and_turns_with_its_angle():
    """H has three strokes, and is a rectangle of its height."""
    made, width = strokes("H", 10.0)
    assert len(made) == 3
    points = np.array([point for stroke in made for point in stroke])
    assert (points[:, 1].min(), points[:, 1].max()) == (0.0, pytest.approx(10.0))
    assert 0.0 < points[:, 0].min() < points[:, 0].max() < width
    flat, _ = cut_places(written("text", {"text": "Größe 42°", "height": 7.0}))
    turned, _ = cut_places(
        written("text", {"text": "Größe 42°", "height": 7.0, "angle": 90.0, "x": 5.0, "y": 1.0})
    )
    assert np.column_stack((5.0 - flat[:, 1], 1.0 + flat[:, 0])) == pytest.approx(
        turned[:, :2], abs=CLOSE
    )
    assert set(map(chr, range(32, 127))) <= set(letters())
    assert {"ä", "ö", "ü", "Ä", "Ö", "Ü", "ß"} <= set(letters())


@pytest.mark.parametrize("kind", list(KINDS))
@pytest.mark.parametrize("machine", [None, "grbl-uno"])
def test_each_job_passes_its_check(kind, machine):
    places = {"x": 100, "y": 100, "x_end": 140, "y_end": 90}
    values = {name: value for name, value in places.items() if name in KINDS[kind].model_fields}
    report = check(from_text(written(kind, values | {"tool": 0})), machine)
    assert [(each.code, each.message) for each in report.findings] == []
    assert report.ok


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        ("round-pocket", {"bore": 6.5}, "the pocket needs 6.6 mm"),
        ("rectangular-pocket", {"width": 5.9}, "narrower than the tool"),
        ("rectangular-pocket", {"width": 6.0, "length": 6.5}, "too short and narrow for a ramp"),
        ("slot", {"width": 5.0}, "narrower than the tool"),
        ("slot", {"x_end": 1.0}, "closer than the tool's radius"),
        ("slot", {"depth": -1.0}, "depth: Input should be greater than 0"),
        ("slot", {"depth": math.nan}, "depth: Input should be"),
        ("slot", {"deep": 1.0}, "deep: Extra inputs"),
        ("hole-grid", {"clear": 1.0}, "clear must be more than 1 mm"),
        ("hole-grid", {"columns": 1000, "rows": 1000}, "more than 100000 lines"),
        ("surfacing", {"diameter": 0.1, "length": 5000, "step_over": 5}, "more than 100000 lines"),
        ("text", {"text": "ж"}, "the letters have no 'ж'"),
        ("text", {"text": "a\nb"}, "the letters have no"),
        ("text", {"text": "a\tM3 S1"}, "the letters have no"),
    ],
)
def test_what_cannot_be_cut_is_refused(kind, values, message):
    with pytest.raises(UsageError, match="job-parameter") as refused:
        written(kind, values)
    assert message in refused.value.diagnostic.message


def test_an_unknown_job_is_refused_and_the_form_has_all_parameters():
    with pytest.raises(UsageError, match="job-kind"):
        written("dovetail", {})
    for job in described():
        names = [parameter["name"] for parameter in job["parameters"]]
        assert set(names) == set(KINDS[job["kind"]].model_fields)
        assert all(parameter["title"] for parameter in job["parameters"])
        assert written(job["kind"], {p["name"]: p["default"] for p in job["parameters"]})


@pytest.mark.parametrize(
    ("dialect", "line"),
    [
        ("linuxcnc", "G4 P2.5"),
        ("grbl", "G4 P2.5"),
        ("mach3", "G4 P2.5"),
        ("fanuc", "G4 P2500"),
        ("haas", "G4 P2500"),
        ("marlin", "G4 P2500"),
        ("siemens", "G4 F2.5"),
    ],
)
def test_the_tool_moves_down_when_the_spindle_has_its_speed(dialect, line):
    """The line is that of each control's manual; the reader of that control reads the time."""
    text = written("surfacing", {"spin_up": 2.5, "tool": 0}, dialect)
    lines = text.splitlines()
    assert lines[lines.index("S10000 M3") + 1] == line
    blocks = list(parse(from_text(text), dialect=dialect))
    waits = [k for k, block in enumerate(blocks) if isinstance(block, Dwell)]
    assert [blocks[k].seconds for k in waits] == [2.5]
    moves = [k for k, b in enumerate(blocks) if isinstance(b, Polyline | ArcFeed)]
    spins = [k for k, b in enumerate(blocks) if isinstance(b, Spindle)]
    assert spins[0] < waits[0] < min(moves)
    assert "G4 " not in written("surfacing", {"spin_up": 0.0}, dialect)

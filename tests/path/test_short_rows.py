"""Rows of moves: how they are cut into blocks changes neither the path nor the findings."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.checks.hints import Hints
from cnc.machine.load import load_machine
from cnc.model.blocks import PathMode, Polyline, Spindle
from cnc.path.block_pieces import FEW
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.path.fit_curves import Arc, chord_ends
from tests.support.path.path_cases import XYZ

COUNT = 60
MACHINE = load_machine()
MODES = {
    "exact path": PathMode("part.nc", 1, "exact-path"),
    "exact stop": PathMode("part.nc", 1, "exact-stop"),
    "tolerance": PathMode("part.nc", 1, "blend", 0.02),
}
SEEDS = st.integers(0, 1 << 32)
CUTS = st.lists(st.integers(1, COUNT - 1), max_size=40)


def rows(seed, cuts):
    """Return a row of moves as blocks that end at ``cuts``.

    Some moves are too short to count, or below a step. There are traverses, and feeds that the
    machine does not reach.
    """
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(COUNT, 3)) * 10.0 ** rng.uniform(-12.0, 1.0, COUNT)[:, None]
    steps[rng.random(COUNT) < 0.1] = 0.0
    points = np.cumsum(steps, axis=0)
    feeds = rng.choice([5.0, 20.0, 1000.0, np.nan], COUNT, p=[0.4, 0.4, 0.1, 0.1])
    lines = np.arange(2, COUNT + 2, dtype=np.int32)
    for first, last in pairwise(sorted({0, *cuts, COUNT})):
        some = slice(first, last)
        yield Polyline("part.nc", int(lines[first]), points[some], feeds[some], lines[some])


def path_of(*blocks):
    chunks = [
        item
        for item in build(iter(blocks), axes=XYZ, start=np.zeros(3))
        if isinstance(item, PathChunk)
    ]
    names = "kind", "data", "length", "feed", "line", "stop_after", "tolerance"
    return {name: np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in names}


def findings_of(*blocks):
    hints = Hints(MACHINE, np.zeros(len(MACHINE.axes)))
    assert list(hints.passed(blocks)) == list(blocks)
    return list(hints.findings())


@pytest.mark.parametrize("mode", MODES)
@given(seed=SEEDS, cuts=CUTS)
def test_a_row_in_parts_is_the_same_path(mode, seed, cuts):
    wanted = path_of(MODES[mode], *rows(seed, range(0, COUNT, FEW + 1)))
    parts = path_of(MODES[mode], *rows(seed, cuts))
    for name, values in wanted.items():
        np.testing.assert_array_equal(parts[name], values, err_msg=name)


@given(seed=SEEDS, cuts=CUTS)
def test_a_row_in_parts_has_the_same_findings(seed, cuts):
    on = Spindle("part.nc", 1, "cw", 1000.0)
    off = Spindle("part.nc", 2, "off", 0.0)
    wanted = findings_of(on, off, *rows(seed, range(0, COUNT, FEW + 1)))
    assert {"move-below-step", "spindle-off"} <= {finding.code for finding in wanted}
    assert findings_of(on, off, *rows(seed, cuts)) == wanted


@given(seed=SEEDS)
def test_the_chords_of_arcs_are_those_of_each(seed):
    rng = np.random.default_rng(seed)
    arcs, tolerance = [], 10.0 ** rng.uniform(-3.0, -1.0)
    for number in range(5):
        i, j = rng.permutation(3)[:2].tolist()
        start, center = rng.normal(size=(2, 3)) * 10.0
        radius = float(np.hypot(start[i] - center[i], start[j] - center[j]))
        angle = float(np.arctan2(start[j] - center[j], start[i] - center[i]))
        sweep, grown = float(rng.choice((-1, 1)) * rng.uniform(0.1, 9.0)), float(rng.normal() * 0.1)
        end = start + rng.normal(size=3)
        end[i] = center[i] + (radius + grown) * np.cos(angle + sweep)
        end[j] = center[j] + (radius + grown) * np.sin(angle + sweep)
        around = float(center[i]), float(center[j])
        arcs.append(Arc(start, end, (i, j), around, radius, grown, angle, sweep, 1.0, number))
    counts = np.array([arc.chords(tolerance) for arc in arcs])
    chords = chord_ends(arcs, counts)
    for arc, count, last in zip(arcs, counts.tolist(), np.cumsum(counts).tolist(), strict=True):
        own = chords[last - count : last]
        exact = [arc.derivatives(part, 0)[0] for part in np.arange(1, count + 1) / count]
        np.testing.assert_allclose(own, exact, rtol=0.0, atol=1e-9)
        ends = np.vstack((arc.start, own))
        np.testing.assert_allclose(arc.last_chord(count), ends[-1] - ends[-2], rtol=0, atol=1e-9)
        # No point of the arc is farther from its chord than 0.04 tolerances.
        middles = [arc.derivatives(part, 0)[0] for part in (np.arange(count) + 0.5) / count]
        far = np.linalg.norm(np.array(middles) - 0.5 * (ends[1:] + ends[:-1]), axis=1)
        assert far.max() <= 0.04 * tolerance * 1.001

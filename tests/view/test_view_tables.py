"""Tables of bounded size keep to their sizes and contain everything that was added."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cnc.view.kernels.motion import Points, new_points
from cnc.view.tables import CurveTable, OriginTable, StrokeTable, tolerance_shown

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(1, 400), st.sampled_from([4, 16, 60]))
def test_ranges_contain_every_phase(seed, count, most):
    random = np.random.default_rng(seed)
    spans = 10.0 ** random.uniform(-4, 1, count)
    t = np.concatenate(([0.0], np.cumsum(spans)))
    phases = np.stack((t[:-1], *random.normal(size=(3, count))), axis=1)
    table = CurveTable(most)
    for part in np.array_split(phases, random.integers(1, 9)):
        table.add(part)
    curves = table.curves(float(t[-1]))
    rows = len(curves.t) - 1
    assert rows <= most
    assert curves.t[0] == 0.0 and curves.t[-1] == t[-1]
    if count <= most:
        assert curves.within == 0.0
        assert (curves.start == phases[:, 1:].T).all()
        return
    # Only rows of one phase are longer than the table states.
    spanned = np.diff(np.searchsorted(t[:-1], curves.t[:-1], side="left"), append=count)
    assert (np.diff(curves.t)[spanned > 1] <= curves.within * (1 + 1e-9)).all()
    for part in np.linspace(0.0, 1.0, 7):
        h = part * spans
        v, a, j = phases[:, 1:].T
        values = np.stack((v + h * (a + 0.5 * h * j), a + h * j, j))
        row = np.searchsorted(curves.t, t[:-1], side="right") - 1
        assert (curves.low[:, row] <= values + 1e-9).all()
        assert (values <= curves.high[:, row] + 1e-9).all()


@given(seeds, st.integers(1, 300), st.sampled_from([4, 8, 50]))
def test_origins_contain_every_line_and_never_mix_files(seed, count, most):
    random = np.random.default_rng(seed)
    t = np.cumsum(10.0 ** random.uniform(-3, 0, count))
    lines, files = random.integers(1, 50, count), np.sort(random.integers(0, 2, count))
    table = OriginTable(most, "0")
    for k in range(count):
        table.add(t[k : k + 1], lines[k : k + 1], str(files[k]), np.array([False]))
    origins, names = table.origins()
    row = np.searchsorted(origins.t, t, side="right") - 1
    assert (origins.first[row] <= lines).all() and (lines <= origins.last[row]).all()
    assert [names[k] for k in origins.file[row]] == [str(file) for file in files]
    assert len(origins.t) <= most + 2


@given(seeds, st.integers(2, 500), st.sampled_from([32, 64]))
def test_strokes_stay_within_their_tolerance(seed, count, most):
    """The points are random, so that the tolerance grows until they fit into the table."""
    random = np.random.default_rng(seed)
    points = new_points(count)
    points.t[:] = points.s[:] = np.cumsum(10.0 ** random.uniform(-3, 0, count))
    points.position[:] = np.cumsum(random.normal(size=(count, 3)), axis=0)
    for column in points.accel, points.jerk, points.rapid:
        column[:] = 0
    table = StrokeTable(most)
    for part in np.array_split(np.arange(count), random.integers(1, 9)):
        table.add(Points(*(column[part] for column in points)))
    strokes = table.strokes(np.zeros(3))
    assert len(strokes.t) <= most
    shown = np.stack([np.interp(points.t, strokes.t, axis) for axis in strokes.position.T], axis=1)
    assert np.linalg.norm(shown - points.position, axis=1).max() <= strokes.tolerance
    assert (strokes.position[[0, -1]] == points.position[[0, -1]]).all()


def test_tolerances_are_rounded_up():
    assert [tolerance_shown(each) for each in (0.001, 0.00101, 0.0123, 1.0, 0.0)] == [
        "0.001",
        "0.0011",
        "0.013",
        "1",
        "0",
    ]

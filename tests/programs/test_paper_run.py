"""The run of the paper, as a user makes it: `cncrun check programs/trident.nc --machine
config/paper-nurbs.toml --trace t.npz --json -`.

Hui, Wei and Gao, TELKOMNIKA 11(5), 2013, section 4, in the mended form of its errata. Everything is
computed again from the written samples: speed, acceleration and jerk by differences of the path
length (they are means over the periods, so they can't exceed a true bound by more than rounding),
the rest by differences of the positions and against the curve as SciPy evaluates it.
"""

import json

import numpy as np
import pytest
from scipy.interpolate import BSpline

from cnc import cli
from tests.support.paths import ROOT

KNOTS = [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]
POINTS = {
    "trident": [(10, 0), (20, 20), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0)],
    "trident-as-printed": [(10, 10), (20, 10), (12, 8), (10, 20), (8, 8), (0, 20), (10, 0)],
}
PERIOD = 0.001
ROUNDING = 1 + 1e-6


@pytest.fixture(scope="module", params=sorted(POINTS))
def run(request, tmp_path_factory):
    """Name, summary, trace, and the rows of the trace that lie on the curve."""
    folder = tmp_path_factory.mktemp("paper")
    trace, summary = folder / "t.npz", folder / "s.json"
    arguments = (
        "check",
        str(ROOT / "programs" / f"{request.param}.nc"),
        "--machine",
        str(ROOT / "config" / "paper-nurbs.toml"),
    )
    assert (
        cli.exit_code([*arguments, "--quiet", "--trace", str(trace), "--json", str(summary)]) == 0
    )
    with np.load(trace) as found:
        columns = dict(found)
    return (
        request.param,
        json.loads(summary.read_text()),
        columns,
        columns["line"] == 8 - ("printed" in request.param),
    )


@pytest.fixture(scope="module")
def curve(run):
    """Arc length from the curve's start and positions on it, densely."""
    spline = BSpline(KNOTS, np.array(POINTS[run[0]], float), 3)
    u = np.linspace(0, 1, 2_000_001)
    points = spline(u)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return s, points


def test_rows_are_a_period_apart(run):
    _, summary, trace, _ = run
    assert trace["period"] == PERIOD
    assert trace["t"] == pytest.approx(np.arange(len(trace["t"])) * PERIOD, abs=1e-12)
    assert summary["duration_s"] <= trace["t"][-1] < summary["duration_s"] + PERIOD


def test_speed_acceleration_and_jerk_stay_within_the_limits(run):
    _, summary, trace, _ = run
    at_rest = np.concatenate([np.zeros(3), trace["s"], np.full(3, trace["s"][-1])])
    limits = {"feed": 300.0, "accel": 2400.0, "jerk": 48000.0}
    for order, (name, limit) in enumerate(limits.items(), start=1):
        by_differences = np.abs(np.diff(at_rest, order)).max() / PERIOD**order
        assert by_differences <= limit * ROUNDING + 4e-14 / PERIOD**order
        assert np.abs(trace[name]).max() <= limit * ROUNDING
        assert np.abs(trace[name]).max() <= summary["max"][name] * ROUNDING
        assert summary["limits"][name] == limit


def test_normal_acceleration_stays_within_half_a_g(run):
    _, summary, trace, _ = run
    p = trace["position"]
    accel = (p[2:] - 2 * p[1:-1] + p[:-2]) / PERIOD**2
    along = p[2:] - p[:-2]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    moving = trace["feed"][1:-1] > 1.0
    normal = np.linalg.norm(accel - (accel * along).sum(axis=1, keepdims=True) * along, axis=1)[
        moving
    ]
    assert normal.max() <= 4903.325 * 1.001
    assert summary["max"]["normal_accel"] <= 4903.325 * ROUNDING
    if run[0] == "trident":
        assert normal.max() >= 4903.325 * 0.98  # it binds, as in the paper


def test_positions_lie_on_the_curve_where_the_path_length_says(run, curve):
    _, _, trace, on_curve = run
    s, points = curve
    there = trace["s"][on_curve] - (trace["s"][-1] - s[-1])
    for axis in range(2):
        assert trace["position"][on_curve, axis] == pytest.approx(
            np.interp(there, s, points[:, axis]), abs=2e-6
        )
    assert (trace["position"][:, 2] == 0).all()


def test_chord_error_is_at_most_a_micrometre(run, curve):
    _, summary, trace, on_curve = run
    s, points = curve
    rows = np.flatnonzero(on_curve)
    there = trace["s"][rows] - (trace["s"][-1] - s[-1])
    start, chord = trace["position"][rows[:-1], :2], np.diff(trace["position"][rows, :2], axis=0)
    length = np.maximum(np.linalg.norm(chord, axis=1), 1e-12)
    largest = 0.0
    for share in np.linspace(0, 1, 17)[1:-1]:
        between = there[:-1] + share * np.diff(there)
        offset = (
            np.stack([np.interp(between, s, points[:, axis]) for axis in range(2)], axis=1) - start
        )
        distance = np.abs(offset[:, 0] * chord[:, 1] - offset[:, 1] * chord[:, 0]) / length
        largest = max(largest, float(distance[length > 1e-4].max()))
    assert largest <= 1e-3
    assert summary["max"]["chord_error"] <= 1e-3
    if run[0] == "trident":
        assert largest <= 6.1359e-4 * 1.005  # the paper's: aN T^2 / 8 = 6.129e-4
        assert largest >= 5.9e-4


def test_step_deviation_is_a_thousandth_at_most(run):
    _, summary, trace, _ = run
    step = np.diff(trace["s"])
    chord = np.linalg.norm(np.diff(trace["position"], axis=0), axis=1)
    long = step > 1e-3
    assert np.abs(1 - chord[long] / step[long]).max() <= 1e-3 * ROUNDING
    assert summary["max"]["step_deviation"] <= 1e-3 * ROUNDING


def test_the_run_starts_and_ends_at_rest(run, curve):
    _, summary, trace, _ = run
    assert trace["position"][0].tolist() == [0, 0, 0]
    assert trace["position"][-1] == pytest.approx([10, 0, 0], abs=1e-9)
    assert trace["feed"][0] == trace["feed"][-1] == 0
    assert trace["s"][-1] == pytest.approx(summary["path_length_mm"], abs=1e-9)
    traverse = np.hypot(*POINTS[run[0]][0])
    assert summary["path_length_mm"] == pytest.approx(traverse + curve[0][-1], abs=1e-6)

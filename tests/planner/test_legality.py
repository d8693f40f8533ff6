"""Legality of traces, checked without the planner's mathematics.

The programs are the table of figures, every shipped program, and random programs.
"""

import numpy as np
import pytest

from cnc.api import load_machine
from cnc.machine.models import Machine
from tests.support.paths import ROOT
from tests.support.planner.figures import Case, cases, machine, with_period
from tests.support.planner.legality import compare_files, examine
from tests.support.planner.random_jobs import random_job
from tests.support.soak import share

PROGRAMS = sorted((ROOT / "programs").glob("*.nc"))
TABLE = list(cases())
LONG = {
    "bezier.nc",
    "drilling.nc",
    "engraving.nc",
    "finishing.nc",
    "pocket.nc",
    "thread-mill.nc",
    "turned-thread.nc",
}
"""Shipped programs whose trace has many rows."""
FEW, MANY = 200, 10_000
"""Lines of the figures' programs that are sampled with the short period too."""


@pytest.mark.parametrize(
    ("case", "period"),
    [
        pytest.param(case, period, id=f"{case.name}-{period}")
        for case in TABLE[:: share(1, 3)]
        for period in (1e-3, 1e-4)
        if period == 1e-3 or case.program.count("\n") < share(MANY, FEW)
    ],
)
def test_the_figures_are_legal_and_fast(case: Case, period: float, tmp_path):
    found = examine(case.program, with_period(case.machine, period), tmp_path)
    assert not found.wrong
    assert found.moved


@pytest.mark.parametrize("period", share([1e-3, 1e-4], [1e-3]))
@pytest.mark.parametrize(
    "program",
    [file for file in PROGRAMS if file.name not in share(set(), LONG)][:: share(1, 2)],
    ids=lambda file: file.name,
)
def test_shipped_programs_are_legal(program, period, tmp_path):
    found = examine(program.read_text(), with_period(load_machine("default"), period), tmp_path)
    assert not found.wrong
    assert found.moved


@pytest.mark.parametrize("first", range(0, share(2000, 20), 20))
def test_random_programs_on_random_machines_are_legal(first, tmp_path):
    for seed in range(first, first + share(20, 3)):
        program, mill = random_job(seed)
        assert not examine(program, mill, tmp_path).wrong, seed


def test_random_programs_have_every_kind_of_move_and_mode():
    text = "".join(random_job(seed)[0] for seed in range(40))
    for code in (
        "G0 ",
        "G1 ",
        "G2 ",
        "G3 ",
        "G06.2 ",
        "G61\n",
        "G61.1\n",
        "G64\n",
        "G64 P0\n",
        "G64 P0.",
        "G4 ",
    ):
        assert code in text


STRICTER = {
    "velocity of x": ("axis", "max_velocity", 100.0),
    "acceleration of x": ("axis", "max_acceleration", 1000.0),
    "jerk of x": ("axis", "max_jerk", 20_000.0),
    "tangential acceleration": ("path", "max_tangential_acceleration", 1000.0),
    "tangential jerk": ("path", "max_jerk", 20_000.0),
    "normal acceleration": ("path", "max_normal_acceleration", 1000.0),
    "chord error": ("path", "chord_error", 1e-4),
    "step deviation": ("path", "step_deviation", 1e-7),
    "feed": ("path", "max_feed", 90.0),
}


@pytest.mark.parametrize("limit", STRICTER)
def test_the_check_finds_each_limit_that_is_broken(limit, tmp_path):
    where, name, value = STRICTER[limit]
    mill = machine()
    part = {name: value}
    axes = {
        letter: axis.model_copy(update=part if (where, letter) == ("axis", "x") else {})
        for letter, axis in mill.axes.items()
    }
    stricter = Machine(
        axes=axes,
        path=mill.path.model_copy(update=part if where == "path" else {}),
        board=mill.board,
    )
    found = examine(
        "G21 G90 G61\nG2 X0 Y0 I5 J0 F9000\nM2\n", mill, tmp_path, compared_with=stricter
    )
    assert [wrong.split(" is ")[0] for wrong in found.wrong] == [limit]


WRONG = {
    "mm from the path": lambda rows: rows["position"].__setitem__((60, 2), 2e-6),
    "passes line": lambda rows: rows.update(
        {name: np.delete(rows[name], range(100, 160), axis=0) for name in ("position", "s", "line")}
    ),
    "end point": lambda rows: rows["position"].__setitem__((-1, 0), 1e-8),
    "numbers that are not finite": lambda rows: rows["jerk"].__setitem__(5, np.nan),
    "a period apart": lambda rows: rows["t"].__setitem__(5, 0.0051),
    "longer than the path length": lambda rows: rows["s"].__imul__(0.999),
    "jerk of": lambda rows: rows["position"].__setitem__((60, 2), 2e-5),
    "the trace ends": lambda rows: rows.update(
        {name: rows[name][:-3] for name in ("t", "position", "s", "line")}
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_the_check_finds_a_changed_trace(wrong, tmp_path):
    mill = machine(per_axis=True)
    found = examine("G21 G90 G61\nG2 X0 Y0 I5 J0 F9000\nM2\n", mill, tmp_path)
    assert not found.wrong
    rows = dict(np.load(tmp_path / "trace.npz"))
    WRONG[wrong](rows)
    np.savez(tmp_path / "changed.npz", **rows)
    again = compare_files(
        tmp_path / "blocks.jsonl",
        tmp_path / "changed.npz",
        tmp_path / "pulses.npz",
        mill,
        found.duration,
    )
    assert any(wrong in each for each in again.wrong)


def test_the_check_finds_a_missing_last_pulse(tmp_path):
    mill = machine()
    found = examine("G21 G90 G61\nG1 X10 F6000\nM2\n", mill, tmp_path)
    pulses = dict(np.load(tmp_path / "pulses.npz"))
    np.savez(
        tmp_path / "changed.npz",
        **{**pulses, **{name: pulses[name][:-1] for name in ("time_ns", "step", "line")}},
    )
    again = compare_files(
        tmp_path / "blocks.jsonl",
        tmp_path / "trace.npz",
        tmp_path / "changed.npz",
        mill,
        found.duration,
    )
    assert any("last pulse" in each for each in again.wrong)

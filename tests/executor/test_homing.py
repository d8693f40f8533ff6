"""Homing against the firmware in the simulator.

The switches follow the position that the pins add up to.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, HomingStopped, home
from cnc.boards.loopback import Loopback
from cnc.cli import exit_code
from cnc.machine.models import Homing, HomingOrder, Machine
from cnc.model.diagnostics import BoardError, CncError, UsageError
from cnc.session.homing import LATCHES, STUCK, AxisHoming, homing_sequence
from tests.support.boards.homing_bench import (
    EVERYWHERE,
    INF,
    PROGRAM,
    QUICK,
    STEPS_PER_MM,
    SWITCH_PINS,
    Bench,
    axis,
    ran,
    rows,
    small,
)
from tests.support.session.runs import run_with
from tests.support.soak import share


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench(**EVERYWHERE)
    yield made
    made.simulator.close()


def test_axes_end_off_their_switches_with_known_positions(bench: Bench) -> None:
    machine = small()
    assert bench.home(machine) == {"x": 0.0, "y": -2.0, "z": 1.0}
    # a switch that closes at -300 has done so in the first move at or behind it: from there 50
    # steps back
    for place, closed in zip(bench.place, (-300 + 50, -410 + 50, 150 - 50), strict=False):
        assert abs(place - closed) <= 1
    assert bench.standing(machine) == (0, -200, 100)
    made = rows(bench)
    first = [int(np.flatnonzero(made[:, column])[0]) for column in range(3)]
    assert first[2] < first[0] < first[1], "Z goes first"
    assert (np.abs(made).sum(axis=1) == 1).all(), "one axis at a time"


def test_order_and_ends_are_those_of_the_machine_file(bench: Bench) -> None:
    up = QUICK.model_copy(update={"end": "high", "position": 7.0})
    machine = small(
        axes={"x": axis((0.0, 8.0), up), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))},
        homing=HomingOrder(order=("y", "x")),
    )
    bench.switches = {**EVERYWHERE, "x": (300, INF)}
    assert bench.home(machine) == {"x": 7.0, "y": -2.0, "z": None}
    made = rows(bench)
    assert not made[:, 2].any()
    assert np.flatnonzero(made[:, 1])[0] == 0
    assert abs(bench.place[0] - 250) <= 1
    assert bench.standing(machine) == (700, -200, None)


@pytest.mark.parametrize("invert", [False, True])
def test_single_axis(bench: Bench, invert: bool) -> None:
    machine = small(
        axes={"x": axis((0.0, 8.0), invert=invert), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))}
    )
    bench.switches = {"x": (300, INF) if invert else (-INF, -300)}
    assert bench.home(machine, "x") == {"x": 0.0, "y": None, "z": None}
    assert abs(bench.place[0]) in (249, 250, 251)
    assert bench.standing(machine) == (0, None, None)


def test_axis_moves_off_a_closed_switch_first(bench: Bench) -> None:
    """Each axis does so in its turn: Z goes up while X is on its switch."""
    bench.switches["x"] = (-INF, 200)
    machine = small()
    assert bench.home(machine) == {"x": 0.0, "y": -2.0, "z": 1.0}
    made = rows(bench)
    assert abs(bench.place[0] - 250) <= 1
    x = made[:, 0][made[:, 0] != 0]
    assert (x[:200] == 1).all(), "away from the switch first"
    assert np.flatnonzero(made[:, 2])[0] < np.flatnonzero(made[:, 0])[0]


@pytest.mark.parametrize(
    ("switches", "farthest"),
    [
        ({}, {"z": 600 + 100}),
        ({"z": (-INF, INF)}, {"z": round(STUCK * 50)}),
        ({"z": (150, 155)}, {"z": 700}),
        ({"z": (150, 152), "x": (5, 5)}, {"z": 700}),
    ],
    ids=["never closes", "never opens", "opens again under way", "no other axis moves"],
)
def test_faulty_switches_are_reported(
    bench: Bench, switches: dict[str, tuple[float, float]], farthest: dict[str, int]
) -> None:
    bench.switches = switches
    machine = small()
    if switches.get("z", (0, 0))[0] == 150:
        # closes for an instant only, the second time not at all
        real = bench.set

        def once() -> None:
            real()
            if bench.place[2] >= 150:
                bench.switches = {}

        bench.set = once  # type: ignore[method-assign]
    with pytest.raises(BoardError) as caught:
        bench.home(machine)
    assert caught.value.diagnostic.code == "homing-switch"
    assert "switch of Z" in caught.value.diagnostic.message
    assert caught.value.diagnostic.hint
    places = np.abs(rows(bench).cumsum(axis=0, dtype=np.int64))
    assert places[:, 2].max() <= farthest["z"]
    assert not places[:, :2].any()
    assert bench.standing(machine) == (None, None, None)


def test_pull_off_that_does_not_open_the_switch(bench: Bench) -> None:
    real, closed = bench.set, False

    def sticky() -> None:
        nonlocal closed
        closed = bench.place[2] >= 150 or (closed and bench.place[2] > 60)
        real()
        bench.simulator.set_pin(SWITCH_PINS["z"], 0 if closed else 1)

    bench.set = sticky  # type: ignore[method-assign]
    with pytest.raises(BoardError) as caught:
        bench.home(small())
    assert caught.value.diagnostic.code == "homing-switch"
    assert "pull_off" in caught.value.diagnostic.hint


def test_switch_of_another_axis_is_an_alarm(bench: Bench) -> None:
    bench.switches = {"z": (150, INF), "x": (-INF, -300), "y": (3, 3)}
    real = bench.set

    def set_pins() -> None:
        real()
        bench.simulator.set_pin(SWITCH_PINS["y"], 0 if bench.place[0] < -100 else 1)

    bench.set = set_pins  # type: ignore[method-assign]
    with pytest.raises(BoardError) as caught:
        bench.home(small())
    assert caught.value.diagnostic.code == "board-limit"
    assert "switch of Y" in caught.value.diagnostic.message
    assert -104 <= bench.place[0] <= -100
    assert bench.standing(small()) == (None, None, None), (
        "motors that are stopped at once may lose steps"
    )


def test_operator_stops_the_homing(bench: Bench) -> None:
    bench.switches["x"] = (-INF, -700)
    control = Control()

    def on_sent(sent: object) -> None:
        if bench.place[0] < -50:
            control.stop()

    with pytest.raises(HomingStopped):
        bench.home(small(), control=control, callbacks=Callbacks(on_sent=on_sent))
    assert bench.standing(small()) == (None, None, 100)
    assert -700 < bench.place[0] < -50


def test_reset_loses_all_positions(bench: Bench) -> None:
    """A computer that fails has the same effect: the board's answer counts."""
    board = bench.driver(small())
    real = bench.set

    def die() -> None:
        real()
        if bench.place[0] < -20:
            raise KeyboardInterrupt

    bench.set = die  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        home(small(), board=board)
    bench.set = real  # type: ignore[method-assign]
    bench.simulator.run(0.5)
    assert bench.standing(small()) == (None, None, 100)


@pytest.mark.soak
@pytest.mark.parametrize("place", share([*range(-950, 950, 25)], [950]))
@pytest.mark.parametrize(("seek", "end"), share([(20.0, "low"), (60.0, "high")], [(60.0, "high")]))
def test_homing_from_any_position(place: int, seek: float, end: str) -> None:
    """The axis starts within its travel, on either side of its switch.

    At a latch speed of half a step for each look at the pins, it ends on the exact step.
    """
    towards = 1 if end == "high" else -1
    way = Homing(end=end, seek=seek, latch=2.0, pull_off=1.0)  # type: ignore[arg-type]
    machine = small(
        axes={"x": axis((0.0, 10.0), way), "y": axis((0.0, 1.0)), "z": axis((0.0, 1.0))}
    )
    bench = Bench(x=(place, INF) if towards > 0 else (-INF, place))
    try:
        assert bench.home(machine, "x")["x"] == (10.0 if towards > 0 else 0.0)
        assert abs(bench.place[0] - (place - towards * 100)) <= 1
    finally:
        bench.simulator.close()


def test_homing_is_within_the_limits(bench: Bench) -> None:
    """The moves to the switch and off it keep the requested speed, and the axis's acceleration and
    jerk.
    """
    machine = small()
    bench.switches = {"z": (550, INF)}
    bench.home(machine, "z")
    cycles, _ = bench.simulator.moves()
    t = cycles / 16e6
    gaps = np.diff(t)[:549]
    assert gaps.min() >= 1 / (20.0 * STEPS_PER_MM) - 1e-5
    # 20 mm/s with 400 mm/s^2 and 15000 mm/s^3 takes 0.05 + 0.0267 s and half as much of 20 mm: the
    # first mm at least half of that
    assert t[100] - t[0] > 0.05


def test_machine_with_switches_must_home_first(bench: Bench, tmp_path: Path) -> None:
    """This holds after a stop by a switch, too. The machine moves again after homing."""
    machine = small()
    refused = ran(bench, machine, tmp_path)
    assert [fault.diagnostic.code for fault in refused.faults] == ["not-homed"]
    assert refused.exit_code == 3
    assert not len(rows(bench))
    assert ran(bench, machine, tmp_path, home=True).ok
    assert [
        abs(place - to) <= 1
        for place, to in zip(bench.place, (-250 + 200, -360 + 200, 0), strict=False)
    ] == [True] * 3
    assert ran(bench, machine, tmp_path).ok, "the board still knows"
    bench.simulator.reset()
    assert not ran(bench, machine, tmp_path).ok


def test_faulty_program_starts_no_homing(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "bad.ngc").write_text("G21 G90\nG1 X2000 F600\nM2\n")
    board = bench.driver(small())
    report = run_with(tmp_path / "bad.ngc", small(), board=board, home=True)
    board.close()
    assert [fault.diagnostic.code for fault in report.faults] == ["soft-limit"]
    assert not len(rows(bench))


def test_machine_without_switches_reports_its_assumption(bench: Bench, tmp_path: Path) -> None:
    machine = small(
        axes={
            letter: each.model_copy(update={"homing": None})
            for letter, each in small().axes.items()
        }
    )
    assert not machine.can_home
    first, second = ran(bench, machine, tmp_path), ran(bench, machine, tmp_path)
    assert first.ok and second.ok
    assert [warning.code for warning in first.warnings] == ["position-assumed"]
    assert "X0 Y0 Z0" in first.warnings[0].message
    assert not second.warnings


def test_home_command(
    bench: Bench,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("cnc.api.open_board", lambda machine, **_: bench.driver(machine))
    file = tmp_path / "m.toml"
    axis_text = "steps_per_mm = 100\nmax_velocity = 40\nmax_acceleration = 400\nmax_jerk = 15000\n"
    axis_text += "homing = { seek = 40, latch = 5, pull_off = 0.5 }\n"
    travels = {"x": "[0, 8]", "y": "[-2, 6]", "z": "[-5, 1]"}
    axes = "".join(
        f"[axes.{letter}]\n{axis_text}travel = {travel}\n" for letter, travel in travels.items()
    )
    file.write_text(axes + '[board]\nkind = "stepper"\n[homing]\norder = ["z", "y", "x"]\n')
    assert exit_code(["home", "--machine", str(file), "y", "x"]) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[-2:] == ["the machine stands at X0 Y-2", "not known: Z"]
    assert shown.index("Y: down") < shown.index("X: down")
    (tmp_path / "p.ngc").write_text(PROGRAM)
    assert exit_code([str(tmp_path / "p.ngc"), "--machine", str(file)]) == 3
    assert "the position of Z" in capsys.readouterr().err
    assert exit_code([str(tmp_path / "p.ngc"), "--machine", str(file), "--home"]) == 0
    bench.switches = {}
    assert exit_code(["home", "--machine", str(file), "--quiet"]) == 3
    assert "homing-switch: the switch of Z did not close within 7 mm" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("machine", "axes", "code"),
    [
        (small(), ("w",), "unknown-axis"),
        (small(axes={**small().axes, "a": axis((0.0, 1.0))}), ("a",), "no-switch"),
        (
            small(axes={"x": axis((0.0, 1.0)).model_copy(update={"travel": None})}),
            (),
            "homing-travel",
        ),
    ],
)
def test_invalid_homing_requests_are_refused(
    machine: Machine, axes: tuple[str, ...], code: str
) -> None:
    with pytest.raises(UsageError) as caught:
        homing_sequence(machine, axes)
    assert caught.value.diagnostic.code == code


def test_board_without_switches() -> None:
    with pytest.raises(CncError) as caught:
        home(small(), board=Loopback(3))
    assert caught.value.diagnostic.code == "no-switches"


def test_defaults_of_homing() -> None:
    """Z is first, upwards; the others follow in their order, downwards, at the speeds of GRBL."""
    machine = small(axes={letter: axis((-10.0, 20.0), None) for letter in "xyz"})
    ways = homing_sequence(machine)
    assert [(way.letter, way.towards, way.rest) for way in ways] == [
        ("z", 1, 20.0),
        ("x", -1, -10.0),
        ("y", -1, -10.0),
    ]
    assert [way.longest for way in ways] == [32.0] * 3
    assert (ways[0].settings.seek, ways[0].settings.latch, ways[0].settings.pull_off) == (
        8.0,
        0.5,
        1.0,
    )
    assert isinstance(ways[0], AxisHoming)
    assert LATCHES * 1.0 < STUCK * 1.0

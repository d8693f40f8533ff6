"""Homing of machines whose joints are not their axes, on the firmware in the simulator."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from cnc.api import home
from cnc.kinematics.delta import Delta
from cnc.kinematics.planar import CoreXY
from cnc.machine.models import Machine
from tests.support.boards.homing_bench import EVERYWHERE, INF, SWITCH_PINS, Bench, axis, rows
from tests.support.soak import share


class BeltBench(Bench):
    """A bench whose switches follow the tip of a CoreXY machine."""

    def set(self) -> None:
        """Set the pins by the axes, in steps of the joints."""
        a, b, z = self.place[:3]
        tip = {"x": (a + b) / 2, "y": (a - b) / 2, "z": z}
        for letter, (low, high) in self.switches.items():
            self.simulator.set_pin(SWITCH_PINS[letter], 0 if low <= tip[letter] <= high else 1)


BELTS = Machine(
    kinematics=CoreXY(type="corexy"),
    axes={"x": axis((0.0, 8.0)), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))},
    joints={"a": axis((-99.0, 99.0)), "b": axis((-99.0, 99.0))},
)


def homed(bench: Bench, machine: Machine, axes: tuple[str, ...] = ()) -> dict[str, float | None]:
    board = bench.driver(machine.of_joints)
    try:
        return home(machine, axes, board=board)
    finally:
        board.close()


@pytest.fixture
def belts() -> Iterator[Bench]:
    made = BeltBench(**EVERYWHERE)
    yield made
    made.simulator.close()


@pytest.mark.soak
def test_corexy_moves_one_axis_at_a_time_with_both_motors(belts: Bench) -> None:
    assert homed(belts, BELTS) == {"x": 0.0, "y": -2.0, "z": 1.0}
    a, b, z = belts.place[:3]
    for place, closed in zip(((a + b) / 2, (a - b) / 2, z), (-250, -360, 100), strict=True):
        assert abs(place - closed) <= 1
    made = rows(belts)[:, :3]
    travelled = np.cumsum(made, axis=0)
    x, y = (travelled[:, 0] + travelled[:, 1]) / 2, (travelled[:, 0] - travelled[:, 1]) / 2
    first = int(np.flatnonzero(np.abs(y) > 1)[0])
    assert abs(x[first] - x[-1]) <= 1, "Y moves when X has come to rest"
    # the position that the board keeps is that of the joints: x = 0, y = -2
    assert belts.standing(BELTS.of_joints) == (-200, 200, 100)


@pytest.mark.parametrize("first", share(["x", "y"], ["y"]))
def test_an_axis_of_belts_homes_the_other_one_unless_it_is_known(belts: Bench, first: str) -> None:
    """Two commands, one for each axis, home both, as on a machine with a motor for each axis."""
    assert homed(belts, BELTS, (first,)) == {"x": 0.0, "y": -2.0, "z": None}
    before = len(rows(belts))
    assert homed(belts, BELTS, ("x",)) == {"x": 0.0, "y": -2.0, "z": None}
    travelled = np.cumsum(rows(belts)[before:, :2], axis=0)
    assert np.abs(travelled[:, 0] - travelled[:, 1]).max() <= 2, "Y rests: it is known"


def test_z_of_belts_homes_alone(belts: Bench) -> None:
    assert homed(belts, BELTS, ("z",)) == {"x": None, "y": None, "z": 1.0}
    assert not rows(belts)[:, :2].any()


def test_each_joint_of_a_delta_homes_alone() -> None:
    """The carriages go up to their switches one after the other."""
    bench = Bench(x=(300, INF), y=(410, INF), z=(150, INF))
    high = axis((100.0, 108.0)).homing
    assert high is not None
    joint = axis((-8.0, 8.0), high.model_copy(update={"end": "high"}))
    machine = Machine(
        kinematics=Delta(type="delta", radius=40.0, rod=90.0),
        axes={letter: axis((-50.0, 50.0)) for letter in ("x", "y", "z")},
        joints=dict.fromkeys(("a", "b", "c"), joint),
    )
    try:
        found = homed(bench, machine)
        assert bench.standing(machine.of_joints) == (800, 800, 800)
        assert (np.abs(rows(bench)).sum(axis=1) == 1).all(), "one joint at a time"
    finally:
        bench.simulator.close()
    assert found["x"] == pytest.approx(0.0, abs=1e-9)
    assert found["y"] == pytest.approx(0.0, abs=1e-9)
    assert found["z"] == pytest.approx(8.0 - np.sqrt(90.0**2 - 40.0**2))

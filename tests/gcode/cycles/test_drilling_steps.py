"""Steps of canned cycles: against moves written by hand, and properties of random holes."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.compiled.jit import interpreted
from cnc.gcode.core.cycle_runner import (
    Cut,
    OperatorStop,
    OrientSpindle,
    Pause,
    Rapid,
    SetOverrides,
    Step,
    Turning,
    TurnSpindle,
    steps,
)
from cnc.gcode.kernels.cycles import Hole, HoleSettings, peck_count
from cnc.gcode.reader.words import G
from tests.support.soak import share

HIGH = Hole(4, 5, bottom=-1, retract=1, clear=3)
LOW = Hole(4, 5, bottom=-1, retract=1, clear=1)
START = (0.0, 0.0, 3.0)
HOW = HoleSettings(feed=10, dwell=0.5, peck=0.75, clearance=0.25, shift=0.1)
FANUC = HoleSettings(
    feed=10,
    dwell=0.5,
    peck=0.75,
    clearance=0.25,
    shift=0.1,
    out_to_retract=True,
    dwells_twice=True,
)
OVER = [Rapid((4, 5, 3)), Rapid((4, 5, 1))]


def cut(height: float) -> Cut:
    return Cut((4, 5, height), 10)


def up(height: float) -> Rapid:
    return Rapid((4, 5, height))


DWELL, OFF, CW, CCW = Pause(0.5), TurnSpindle("off"), TurnSpindle("cw"), TurnSpindle("ccw")
LOCK, UNLOCK = SetOverrides(overrides=False), SetOverrides(overrides=True)

TABLE: list[tuple[int, Hole, HoleSettings, list[Step]]] = [
    (810, HIGH, HoleSettings(feed=10), [cut(-1), up(3)]),
    (810, LOW, HoleSettings(feed=10), [cut(-1), up(1)]),
    (820, HIGH, HOW, [cut(-1), DWELL, up(3)]),
    (
        830,
        HIGH,
        HOW,
        [cut(0.25), up(1), up(0.5), cut(-0.5), up(1), up(-0.25), cut(-1), DWELL, up(3)],
    ),
    (830, LOW, HoleSettings(feed=10, peck=9, clearance=0.25), [cut(-1), up(1)]),
    (730, HIGH, HOW, [cut(0.25), up(0.5), cut(-0.5), up(-0.25), cut(-1), DWELL, up(3)]),
    (840, HIGH, HOW, [LOCK, cut(-1), OFF, CCW, DWELL, cut(3), OFF, CW, UNLOCK]),
    (840, HIGH, FANUC, [LOCK, cut(-1), DWELL, OFF, CCW, cut(1), DWELL, OFF, CW, UNLOCK, up(3)]),
    (
        740,
        LOW,
        HoleSettings(feed=10),
        [LOCK, cut(-1), OFF, CW, cut(1), OFF, CCW, UNLOCK],
    ),
    (850, HIGH, HOW, [cut(-1), cut(1), up(3)]),
    (850, LOW, HOW, [cut(-1), cut(1)]),
    (860, HIGH, HOW, [cut(-1), DWELL, OFF, up(3), CW]),
    (880, HIGH, HOW, [cut(-1), DWELL, OFF, OperatorStop(), up(3), CW]),
    (890, HIGH, HOW, [cut(-1), DWELL, cut(3)]),
    (890, HIGH, FANUC, [cut(-1), DWELL, cut(1), up(3)]),
    (
        760,
        HIGH,
        HOW,
        [cut(-1), DWELL, OFF, OrientSpindle(), Rapid((4.1, 5, -1)), Rapid((4.1, 5, 3)), up(3), CW],
    ),
]


@pytest.mark.parametrize(
    ("cycle", "hole", "settings", "expected"),
    TABLE,
    ids=lambda value: str(value) if isinstance(value, int) else "",
)
def test_the_steps_of_each_cycle(
    cycle: int, hole: Hole, settings: HoleSettings, expected: list[Step]
) -> None:
    turning: Turning = "ccw" if cycle == 740 else "cw"
    assert list(steps(G(cycle), START, [hole], settings, turning)) == OVER + expected


def test_below_r_the_tool_rises_before_it_moves_across() -> None:
    found = list(steps(G.G81, (0, 0, -7), [LOW], HoleSettings(feed=10), "cw"))
    assert found == [Rapid((0, 0, 1)), Rapid((4, 5, 1)), cut(-1), up(1)]


def test_above_r_the_tool_moves_across_at_its_height() -> None:
    found = list(steps(G.G81, (0, 0, 9), [LOW], HoleSettings(feed=10), "cw"))
    assert found == [Rapid((4, 5, 9)), Rapid((4, 5, 1)), cut(-1), up(1)]


def test_between_holes_the_tool_keeps_its_height() -> None:
    second = Hole(6, 5, -1, 1, 3)
    found = list(steps(G.G81, START, [HIGH, second], HoleSettings(feed=10), "cw"))
    assert found[4:6] == [Rapid((6, 5, 3)), Rapid((6, 5, 1))]


@pytest.mark.parametrize(
    ("top", "bottom", "peck", "count"),
    [(1, -1, 0.1, 20), (0.3, 0, 0.1, 3), (1, -1, 0.75, 3), (1, 1, 1, 1), (0, -1, 1, 1)],
)
def test_rounding_does_not_change_the_number_of_pecks(
    top: float, bottom: float, peck: float, count: int
) -> None:
    """1 - 20 * 0.1 is not -1 to the bit."""
    assert interpreted(peck_count)(top, bottom, peck) == count


def test_a_short_peck_does_not_retract_above_r() -> None:
    settings = HoleSettings(feed=10, peck=0.1, clearance=0.25)
    for cycle in (G.G73, G.G83):
        found = list(steps(cycle, (4, 5, 1), [LOW], settings, "cw"))
        assert max(step.to[2] for step in found if isinstance(step, Rapid | Cut)) == 1


heights = st.floats(-50, 50, allow_nan=False)
holes = st.builds(
    lambda first, second, bottom, deep, above: Hole(
        first, second, bottom, bottom + deep, bottom + deep + above
    ),
    heights,
    heights,
    heights,
    st.floats(0, 40),
    st.floats(0, 20),
)
settings_of_holes = st.builds(
    HoleSettings,
    feed=st.just(10.0),
    dwell=st.sampled_from([0.0, 1.5]),
    peck=st.floats(0.05, 60),
    clearance=st.floats(0, 1),
    shift=st.floats(0, 1),
    out_to_retract=st.booleans(),
    dwells_twice=st.booleans(),
    # Shrinking pecks have valid settings only: the interpreter refuses others before.
    less=st.just(0.0),
    least=st.just(0.0),
)
CYCLES = (730, 740, 760, 810, 820, 830, 840, 850, 860, 880, 890)


@settings(max_examples=share(20000, 40), deadline=None)
@given(
    cycle=st.sampled_from(CYCLES),
    many=st.lists(holes, min_size=1, max_size=3),
    settings=settings_of_holes,
    height=heights,
)
def test_no_traverse_enters_material(
    cycle: int, many: list[Hole], settings: HoleSettings, height: float
) -> None:
    """Sideways only at R or above (fine boring: its shift in the hole), down by traverse only to R
    or into what has been drilled.
    """
    place, reached = (0.0, 0.0, height), math.inf
    for hole in many:
        for step in steps(G(cycle), place, [hole], settings, "cw"):
            if isinstance(step, Cut):
                assert step.to[:2] == (hole.first, hole.second) == place[:2]
                assert hole.bottom <= step.to[2] <= hole.clear
                reached = min(reached, step.to[2])
            elif isinstance(step, Rapid):
                aside = step.to[:2] != place[:2]
                if aside and not (cycle == 760 and place[2] == hole.bottom):
                    assert step.to[2] == place[2] >= hole.retract
                if step.to[2] < place[2]:
                    assert step.to[2] >= min(hole.retract, reached)
                    assert step.to[2] >= min(hole.retract, reached + settings.clearance)
            if isinstance(step, Rapid | Cut):
                assert step.to != place
                place = step.to
        assert place == (hole.first, hole.second, hole.clear)
        assert reached == hole.bottom or hole.bottom == hole.retract
        reached = math.inf


@settings(max_examples=share(5000, 14), deadline=None)
@given(
    cycle=st.sampled_from(CYCLES),
    hole=holes,
    settings=settings_of_holes,
    turning=st.sampled_from(["cw", "ccw"]),
)
def test_spindle_and_overrides_end_as_they_were(
    cycle: int, hole: Hole, settings: HoleSettings, turning: Turning
) -> None:
    found = list(steps(G(cycle), START, [hole], settings, turning))
    turns = [step.state for step in found if isinstance(step, TurnSpindle)]
    assert not turns or turns[-1] == turning
    locks = [step.overrides for step in found if isinstance(step, SetOverrides)]
    assert locks in ([], [False, True])

"""Roughing cycles G71 and G72 on random profiles, against a simulation of the stock."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.gcode.turning_cases import (
    TOP,
    Floats,
    Move,
    Setup,
    Stock,
    lathe_blocks,
    moves_of,
    parts,
)
from tests.support.soak import share

KINDS = ("outside", "inside", "facing")
ROUGHING_LINE = 4
"""Line of G71 P Q in the programs; the moves of the cycle have it."""
ROUNDING = 2e-3
"""Coordinates have four decimals, and X is a diameter; arcs are sampled."""


@st.composite
def setups(draw: st.DrawFn) -> Setup:
    pockets = draw(st.booleans())
    part = draw(parts(pockets=pockets))
    along = 0.0 if part.falls else draw(st.sampled_from((0.0, 0.1)))
    return Setup(
        kind=draw(st.sampled_from(KINDS)),
        part=part,
        depth=draw(st.sampled_from((0.7, 1.5, 2.0, 6.0, 40.0))),
        retract=draw(st.sampled_from((0.0, 0.5, 3.0))),
        allowance=(along, draw(st.sampled_from((0.0, 0.2, 0.35)))),
        pockets=pockets,
    )


def split(setup: Setup) -> tuple[list[Move], list[Move]]:
    """The moves of roughing and those of finishing."""
    x, z = 0.0, 0.0
    moves = moves_of(lathe_blocks(setup.program()), (x, z))
    last = max(index for index, move in enumerate(moves) if move.line == ROUGHING_LINE)
    return [move for move in moves[: last + 1] if move.line == ROUGHING_LINE], moves[last + 1 :]


def limits(points: Floats, along: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest level of a profile near each place along."""
    near = [np.interp(along + shift, points[:, 0], points[:, 1]) for shift in (-3e-3, 0.0, 3e-3)]
    return np.min(near, axis=0) - ROUNDING, np.max(near, axis=0) + ROUNDING


@settings(max_examples=share(1500, 17), deadline=None)
@given(setups())
def test_passes_stay_outside_and_shallow_and_traverses_in_the_air(setup: Setup) -> None:
    rough, finish = split(setup)
    length = setup.part.elements[-1].along - setup.allowance[0]
    stock = Stock(length)
    profile = setup.part.points()
    leave = profile + (-setup.allowance[0], setup.allowance[1])
    low, high = limits(leave, stock.along)
    for move in rough:
        points = setup.seen(move.points)
        if move.rapid:
            assert stock.check_rapid(points) < ROUNDING, move
        else:
            assert stock.cut(points) < setup.depth + ROUNDING, move
            assert (stock.level > np.minimum(low, TOP - ROUNDING)).all(), move
    assert (stock.level < high).all()
    for move in finish:
        points = setup.seen(move.points)
        if move.rapid:
            assert stock.check_rapid(points) < ROUNDING, move
        else:
            stock.cut(points)
    low, high = limits(profile, stock.along)
    assert ((stock.level > low) & (stock.level < high)).all()


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=share(200, 6), deadline=None)
@given(part=parts(pockets=True))
def test_finishing_moves_end_at_the_points_of_the_profile(kind: str, part: object) -> None:
    setup = Setup(kind, part, 2.0, 0.5, (0.0, 0.2), pockets=True)  # type: ignore[arg-type]
    _, finish = split(setup)
    ends = [setup.seen(move.points)[-1] for move in finish if not move.rapid]
    expected = [(each.along, each.across) for each in setup.part.elements]
    np.testing.assert_allclose(ends, expected, atol=1e-3)

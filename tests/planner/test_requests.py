"""Requests of the operator at random moments take effect within the promised time.

That is a slice of motion, which the board has, the rest of a motion past corners that is under way,
and the ramp. On bends the axes leave less for a ramp than on a straight line.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import PathMode
from cnc.model.operator_control import Control
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import SLICE
from tests.support.planner.motions import lines, machine, path_of
from tests.support.planner.requests import (
    FAMILIES,
    answered,
    last_above,
    random_program,
    stop_time,
)
from tests.support.soak import share

RAMPS = 2.5
"""A motion slows within this many ramps to rest on a straight line along the slowest axis."""

RAMPS_TO_REST = 4.0
"""It rests within this many: between two tight bends it may have to cross one of them before."""

BEHIND = 2.0
"""At the new feed the motion loses no more than so many of these ramps, a slice, and the rest of
a motion past corners.
"""

REQUESTS = share(10_000, 20)
EACH = share(5, 2)
"""Requests for one program."""

PROGRAMS = [
    (family, number) for family in FAMILIES for number in range(REQUESTS // (EACH * len(FAMILIES)))
]


@pytest.mark.parametrize(("family", "number"), PROGRAMS)
def test_a_request_takes_effect_within_the_promised_time(
    family: str, number: int, tmp_path: Path
) -> None:
    """The message has the seed, which is a new one in each run of ``make soak``."""
    seed = share(int(np.random.default_rng().integers(2**32)), 1)
    rng = np.random.default_rng([seed, FAMILIES.index(family), number])
    program = random_program(family, rng, tmp_path)
    for trial in range(EACH):
        answer = answered(program, rng)
        if answer is None:
            continue
        message = (seed, family, number, trial, answer)
        ramps = RAMPS if answer.request > 0.0 else RAMPS_TO_REST
        late = SLICE + ramps * answer.ramp
        # A slice of slow motion is longer: it covers 0.01 mm.
        assert answer.delay <= answer.chain + 1.5 * SLICE, message
        assert answer.effect <= answer.chain + late, message
        assert answer.behind <= BEHIND * answer.ramp + answer.chain + SLICE, message


def rosette(petals: int, chords: int) -> np.ndarray:
    """Return points of a rosette of 60 mm, from its first one on."""
    u = np.linspace(0.0, 2.0 * math.pi, chords + 1)
    radius = 20.0 + 10.0 * np.cos(petals * u)
    points = np.stack((radius * np.cos(u), radius * np.sin(u), np.zeros(chords + 1)), axis=1)
    return (points - points[0]).round(3)[1:]


@pytest.mark.parametrize("percent", [50.0, 20.0, 80.0][:: share(1, 3)])
@pytest.mark.parametrize("moment", [0.3, 1.0, 1.7][:: share(1, 2)])
def test_a_lower_feed_is_reached_where_the_axes_are_at_their_limits(percent, moment):
    """Nearly every moment of the motion has an axis at its limit of jerk or acceleration."""
    axis = Axis(steps_per_mm=100.0, max_velocity=300.0, max_acceleration=1000.0, max_jerk=10_000.0)
    mill = Machine(axes=dict.fromkeys("xyz", axis), path=PathLimits(max_feed=300.0))
    path = list(path_of([PathMode("t.nc", 1, "blend", 0.01), lines(rosette(7, 600), 100.0)]))
    control, requested, above, speed = Control(), math.nan, 0.0, 0.0
    for plan in LookAhead(mill, control).plan(path):
        assert isinstance(plan, PlanChunk)
        end = plan.t0 + plan.duration
        if math.isnan(requested) and end >= moment:
            control.override(percent)
            requested, speed = end, float(plan.phase_v.max())
        elif end > requested:
            lines_of = dict.fromkeys(plan.path.line.tolist(), 100.0)
            above = last_above(plan, lines_of, percent / 100.0) or above
    assert speed > 60.0
    assert above - requested <= stop_time(speed, mill)


def test_a_request_that_cannot_be_planned_is_not_reported_as_planned(monkeypatch):
    """As long as the window refuses an override, the factor in effect stays the one before."""
    monkeypatch.setattr("cnc.planner.window.Window.override", lambda window, factor: False)
    control = Control()
    ahead = LookAhead(machine(), control)
    for _ in ahead.plan(path_of([lines([(50.0, 0.0, 0.0)])])):
        control.override(50.0)
        assert ahead.feed_factor == 1.0


@pytest.mark.parametrize("family", FAMILIES)
def test_no_value_exceeds_its_limit(family: str, tmp_path: Path) -> None:
    """The audit allows for rounding; the planner needs none of it."""
    for number in range(share(100, 3)):
        rng = np.random.default_rng([7, FAMILIES.index(family), number])
        program = random_program(family, rng, tmp_path)
        ahead = LookAhead(program.machine)
        plans = [item for item in ahead.plan(program.path) if isinstance(item, PlanChunk)]
        if not plans:
            continue
        shares = ahead.audit.shares(plans[0].path.axes)
        assert max(shares.values()) <= 1.0 + 1e-7, (number, shares)

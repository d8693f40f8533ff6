"""Holds and overrides while the motion slows for a joint at which the curvature jumps.

At the low feed behind the joint the jump takes a small share of the jerk limit. A motion that slows
from a higher feed may need a constant speed there.
"""

import math

import numpy as np
import pytest

from cnc.model.blocks import ArcFeed, Held
from cnc.model.operator_control import Control
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from tests.support.planner.motions import arc, machine, path_of
from tests.support.soak import share


def tangent_arcs(rng: np.random.Generator, jerk: float, period: float) -> list[ArcFeed]:
    """Return a wide arc at a high feed and a narrow one, tangent to it, at a low feed.

    The jump of curvature takes 4 to 50 % of the jerk limit at the low feed.
    """
    narrow = 10 ** rng.uniform(-1.3, 0.3)
    part = 10 ** rng.uniform(-1.4, -0.3)
    slow = math.sqrt(part * jerk * period * narrow / 0.75)
    wide = rng.uniform(10.0, 40.0)
    centre = np.array([0.0, wide])
    first = arc(np.zeros(3), centre, rng.uniform(0.1, 0.5), 10 ** rng.uniform(1.3, 2.3))
    out = (first.end[:2] - centre) / wide
    side = float(rng.choice((-1.0, 1.0)))
    second = arc(first.end, first.end[:2] - side * narrow * out, side * rng.uniform(0.1, 0.6), slow)
    return [first, second]


@pytest.mark.parametrize("seed", range(share(1000, 1)))
def test_a_request_before_a_joint_with_a_jump_of_curvature_is_legal(seed, monkeypatch):
    """The plans are legal at once: none has to be made again more slowly."""
    monkeypatch.setattr("cnc.planner.lookahead.MOST_CAUTION", 0)
    rng = np.random.default_rng(seed)
    jerk = 10 ** rng.uniform(3.7, 4.7)
    mill = machine(
        axis=(10 ** rng.uniform(2.5, 3.7), jerk), tangential=None, normal=None, jerk=None
    )
    blocks = tangent_arcs(rng, jerk, mill.path.period)
    (plan,) = [
        item for item in LookAhead(mill).plan(path_of(blocks)) if isinstance(item, PlanChunk)
    ]
    at_joint = float(np.interp(plan.piece_s[1], plan.phase_s, plan.phase_t))
    when = at_joint - 10 ** rng.uniform(-3.0, -0.7)
    control = Control()
    ahead = LookAhead(mill, control, slice_s=0.002)
    waits = True
    for item in ahead.plan(path_of(blocks)):
        assert ahead._refusal() is None
        if isinstance(item, Held):
            control.resume()
        elif waits and item.t0 + item.duration >= when:
            waits = False
            if rng.random() < 0.5:
                control.hold()
            else:
                control.override(10 ** rng.uniform(0.5, 1.9))
    assert not ahead.audit.violations

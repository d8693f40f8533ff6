"""Motion under an operator, and whether it is continuous and legal."""

from collections.abc import Callable

import numpy as np
import pytest

from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held
from cnc.model.operator_control import Control
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.sampled import Sampled
from tests.support.planner.motions import machine, path_of

Plans = list[PlanChunk]


def driven(
    blocks: list[Block], mill, watch: Callable[[Control, Plans, bool], None]
) -> tuple[Plans, list[int]]:
    """Return the plans under an operator, and the number of plans before each hold.

    ``watch`` is called after every slice and at every hold.
    """
    control, chunks, holds = Control(), [], []
    ahead = LookAhead(mill, control)
    for item in ahead.plan(path_of(blocks)):
        if isinstance(item, Held):
            holds.append(len(chunks))
            assert len(holds) < 1000
        elif isinstance(item, PlanChunk):
            chunks.append(item)
        watch(control, chunks, isinstance(item, Held))
    assert not ahead.audit.violations
    return chunks, holds


def assert_on_the_path(chunks: Plans) -> None:
    """Assert that chunks are continuous in time, place, speed and acceleration."""
    clock = travelled = v = a = 0.0
    for chunk in chunks:
        assert chunk.t0 == pytest.approx(clock, abs=1e-9)
        assert chunk.s0 + chunk.phase_s[0] == pytest.approx(travelled, abs=1e-9)
        assert (chunk.phase_v[0], chunk.phase_a[0]) == pytest.approx((v, a), abs=1e-6)
        clock, travelled = chunk.t0 + chunk.duration, chunk.s0 + chunk.phase_s[-1]
        v, a = chunk.phase_v[-1], chunk.phase_a[-1]
    assert (v, a) == (0.0, 0.0)


def assert_legal_by_positions(chunks: Plans, mill) -> None:
    """Assert that differences of sampled positions keep the limits of each axis."""
    limits, period = Limits.of(mill), mill.path.period
    sampler = Sampled(period, np.zeros(3))
    end = chunks[-1].t0 + chunks[-1].duration
    rows = [part.position for chunk in chunks for part in sampler.samples(chunk)] + [
        part.position for part in sampler.finish(end)
    ]
    points = np.concatenate(rows)
    for order, bound in (
        (1, limits.axis_velocity),
        (2, limits.axis_acceleration),
        (3, limits.axis_jerk),
    ):
        seen = np.abs(np.diff(points, order, axis=0)).max(axis=0, initial=0.0) / period**order
        assert (seen <= bound * 1.001 + 2**order * 2e-12 / period**order).all(), (
            order,
            seen,
            bound,
        )


def random_machine(rng):
    return machine(
        axis=(10 ** rng.uniform(1.5, 4.5), 10 ** rng.uniform(3, 7)) if rng.random() < 0.6 else None,
        tangential=10 ** rng.uniform(1.5, 4.5),
        normal=10 ** rng.uniform(1.5, 4.5),
        jerk=10 ** rng.uniform(3, 7),
        period=float(rng.choice((0.001, 0.0001))),
        velocity=10 ** rng.uniform(1, 3),
    )


def speeds(chunk: PlanChunk) -> np.ndarray:
    """Return the speed at points throughout the phases."""
    t = np.diff(chunk.phase_t)[:, None] * np.linspace(0.0, 1.0, 9)
    return (
        chunk.phase_v[:-1, None] + t * (chunk.phase_a[:-1, None] + t * chunk.phase_j[:, None] / 2)
    ).ravel()


def operate(rng: np.random.Generator, control: Control, often: float, lowest: float) -> None:
    """Hold, resume, or override by 10**``lowest`` per cent or more, at a random moment."""
    if control.held:
        if rng.random() < 0.5:
            control.resume()
    elif rng.random() < often:
        if rng.random() < 0.4:
            control.hold()
        else:
            control.override(float(10 ** rng.uniform(lowest, 2.3)))


def assert_legal_under_operator(
    rng: np.random.Generator,
    mill: Machine,
    blocks: list[Block],
    operated: bool,
    lowest: float,
    seed: int,
) -> None:
    """Assert that a motion is legal and ends at rest at the end of its path.

    A run with more holds than the operator requests has no end. A hold is shown again until the
    operator resumes.
    """
    control = Control() if operated else None
    often = 10 ** rng.uniform(-2.0, -0.5)
    ahead = LookAhead(mill, control)
    holds, requested, resting, end = 0, 0, False, None
    for item in ahead.plan(path_of(blocks)):
        if isinstance(item, Held):
            holds += not resting
            assert holds <= requested, seed
        elif isinstance(item, PlanChunk):
            end = item
        if control is not None:
            held = control.held
            operate(rng, control, often, lowest)
            requested += control.held and not held
        resting = isinstance(item, Held)
    assert not ahead.audit.violations, seed
    assert end is None or (end.phase_v[-1], end.phase_a[-1]) == (0.0, 0.0), seed

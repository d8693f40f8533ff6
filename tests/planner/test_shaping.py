"""Motion that does not ring: what remains behind it, its path, its limits, its time, requests."""

import math

import numpy as np
import pytest

from cnc.machine.models import Machine, VibrationMode
from cnc.model.blocks import Block, Dwell, Held, PathMode, SpindleSync
from cnc.model.operator_control import Control
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from tests.planner.test_random_programs import random_machine, random_program
from tests.support.planner.motions import arc, lines, machine, path_of
from tests.support.planner.operated import (
    assert_legal_by_positions,
    assert_legal_under_operator,
    assert_on_the_path,
    driven,
)
from tests.support.planner.oscillator import residuals
from tests.support.soak import share

Modes = dict[str, tuple[float, float]]
OFF = ((0.8, 0.10), (0.9, 0.05), (1.0, 0.05), (1.1, 0.05), (1.2, 0.10))
"""True frequency by the named one, and the part of the amplitude that may remain."""


def ringing(mill: Machine, modes: Modes) -> Machine:
    """Return a machine whose axes have modes: frequency and damping of each."""
    table = {
        name: (VibrationMode(frequency=frequency, damping=damping),)
        for name, (frequency, damping) in modes.items()
    }
    return mill.model_copy(update={"vibration": table})


def plans(blocks: list[Block], mill: Machine) -> list[PlanChunk]:
    items = LookAhead(mill).plan(path_of(blocks))
    return [item for item in items if isinstance(item, PlanChunk)]


def end_of(motion: list[PlanChunk]) -> float:
    return motion[-1].t0 + motion[-1].duration


def random_mill(rng: np.random.Generator) -> Machine:
    accel = 10 ** rng.uniform(2.5, 3.7)
    return machine(
        axis=(accel, accel * 10 ** rng.uniform(1.0, 2.0)),
        tangential=None,
        normal=None,
        jerk=None,
        velocity=250.0,
        max_feed=float(rng.uniform(20.0, 250.0)),
    )


def random_modes(rng: np.random.Generator, names: str = "xy") -> Modes:
    return {name: (rng.uniform(15.0, 80.0), rng.uniform(0.02, 0.1)) for name in names}


@pytest.mark.parametrize("seed", range(share(200, 4)))
def test_little_remains_after_moves_and_reversals(seed: int) -> None:
    """Straight moves with rests: of each oscillator 5 % remains, 10 % if it is off by 20 %."""
    rng = np.random.default_rng([seed, 1])
    mill, modes = random_mill(rng), random_modes(rng)
    blocks: list[Block] = []
    for line in range(1, 6):
        end = np.append(rng.normal(0.0, 10 ** rng.uniform(-0.5, 1.7), 2), 0.0)
        blocks += [lines(end, 250.0, line), Dwell("t.nc", line, 0.5)]
    plain, shaped = plans(blocks, mill), plans(blocks, ringing(mill, modes))
    oscillators = [
        (column, part * frequency, damping)
        for column, (frequency, damping) in enumerate(modes.values())
        for part, _ in OFF
    ]
    before, after = (residuals(motion, oscillators).max(axis=0) for motion in (plain, shaped))
    # What rings from the moves before is part of both.
    assert (after <= 1.05 * np.tile([allowed for _, allowed in OFF], 2) * before + 1e-6).all()


@pytest.mark.parametrize("seed", range(share(200, 4)))
def test_a_stop_takes_at_most_a_period_longer(seed: int) -> None:
    """That of the slowest mode of the axes that move; two modes may take a tenth more."""
    rng = np.random.default_rng([seed, 2])
    mill, modes = random_mill(rng), random_modes(rng)
    periods = {name: 1.0 / frequency for name, (frequency, _) in modes.items()}
    for moved, allowed in (
        ("x", periods["x"]),
        ("y", periods["y"]),
        ("xy", 1.25 * max(periods.values())),
    ):
        end = [rng.uniform(1.0, 50.0) if name in moved else 0.0 for name in "xyz"]
        block: list[Block] = [lines(end, 250.0)]
        added = end_of(plans(block, ringing(mill, modes))) - end_of(plans(block, mill))
        assert 0.5 * min(periods[name] for name in moved) < added < allowed


def test_an_axis_without_modes_is_not_slower() -> None:
    mill = machine()
    block: list[Block] = [lines((0.0, 0.0, 20.0))]
    own = end_of(plans(block, ringing(mill, {"x": (20.0, 0.05)})))
    assert own == pytest.approx(end_of(plans(block, mill)), abs=1e-9)
    of_tool = end_of(plans(block, ringing(mill, {"tool": (20.0, 0.05)})))
    assert of_tool > own + 0.03


def test_a_shaper_may_be_longer_than_a_second() -> None:
    """In slices: the motion that it mixes is long past."""
    modes = {"x": (1.0, 0.0), "tool": (1.3, 0.0)}
    motion, _ = driven([lines((100.0, 0.0, 0.0), 20.0)], ringing(machine(), modes), lambda *_: None)
    assert_on_the_path(motion)
    assert motion[-1].positions(np.array([motion[-1].duration]))[0, 0] == pytest.approx(100.0)


def test_an_arc_moves_the_axes_of_its_plane() -> None:
    """Also a whole circle, which ends where it begins."""
    mill = machine()
    circle: list[Block] = [arc((0.0, 0.0, 0.0), (10.0, 0.0), 1.0)]
    plain = end_of(plans(circle, mill))
    assert end_of(plans(circle, ringing(mill, {"y": (20.0, 0.05)}))) > plain + 0.03
    assert end_of(plans(circle, ringing(mill, {"z": (20.0, 0.05)}))) < plain + 0.03


@pytest.mark.parametrize("seed", range(share(400, 6)))
def test_shaped_motion_is_legal_on_any_path_under_an_operator(seed: int) -> None:
    rng = np.random.default_rng([seed, 3])
    mill = random_machine(rng)
    blocks = random_program(rng, mill)
    names = [name for name in ("x", "y", "z", "tool") if rng.random() < 0.5] or ["x"]
    modes = {name: (rng.uniform(15.0, 80.0), rng.uniform(0.0, 0.1)) for name in names}
    operated = rng.random() < 0.5
    assert_legal_under_operator(rng, ringing(mill, modes), blocks, operated, 1.0, seed)


@pytest.mark.parametrize("seed", range(share(100, 4)))
def test_the_path_and_the_limits_of_axes_are_kept(seed: int) -> None:
    """By other means than the audit: differences of sampled positions; the lines themselves."""
    rng = np.random.default_rng([seed, 4])
    mill = ringing(random_mill(rng), random_modes(rng))
    corners = np.cumsum(rng.normal(0.0, 8.0, (6, 3)) * (1.0, 1.0, 0.0), axis=0)
    feeds = 10 ** rng.uniform(0.5, 2.3, 6)
    motion = plans([PathMode("t.nc", 1, "exact-path"), lines(corners, feeds)], mill)
    assert_on_the_path(motion)
    assert_legal_by_positions(motion, mill)
    legs = np.concatenate((np.zeros((1, 3)), corners))
    along, starts = np.diff(legs, axis=0), legs[:-1]
    for plan in motion:
        places = plan.positions(np.linspace(0.0, plan.duration, 40))
        share_of = np.clip(
            ((places[:, None] - starts) * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0
        )
        nearest = starts + share_of[..., None] * along
        assert np.linalg.norm(places[:, None] - nearest, axis=2).min(axis=1).max() < 1e-9


def test_corners_under_a_tolerance_are_stops() -> None:
    """What passes a corner changes the speeds of axes in an instant, and they ring."""
    legs = [(20.0, 0.0, 0.0), (20.0, 20.0, 0.0)]
    blocks: list[Block] = [PathMode("t.nc", 1, "blend", 0.05), lines(legs)]
    mill, modes = machine(axis=(1000.0, 20000.0)), {"x": (30.0, 0.05), "y": (30.0, 0.05)}
    plain, shaped = plans(blocks, mill), plans(blocks, ringing(mill, modes))
    rests = [plan for plan in shaped if plan.phase_v[-1] == 0.0]
    assert len(rests) == 2
    oscillators = [(0, 30.0, 0.05), (1, 30.0, 0.05)]
    before, after = (residuals(motion, oscillators)[-1] for motion in (plain, shaped))
    assert (after < 0.06 * before.max()).all()


def test_motion_that_follows_the_spindle_is_not_shaped() -> None:
    """Its place belongs to the angle of the spindle."""
    mill = ringing(machine(), {"tool": (20.0, 0.05)})
    thread = [SpindleSync("t.nc", 1, 1.0), lines((0.0, 0.0, 20.0))]
    behind = [SpindleSync("t.nc", 2, 0.0), lines((0.0, 0.0, 0.0))]
    plain = end_of(plans([*thread, *behind], machine()))
    assert end_of(plans(thread, mill)) == pytest.approx(end_of(plans(thread, machine())))
    assert end_of(plans([*thread, *behind], mill)) > plain + 0.03


@pytest.mark.parametrize("seed", range(share(100, 4)))
def test_a_hold_rings_little_too(seed: int) -> None:
    """A hold in the middle of a move: later by less than a period than without shaping."""
    rng = np.random.default_rng([seed, 5])
    mill, frequency = random_mill(rng), rng.uniform(20.0, 60.0)
    blocks: list[Block] = [lines((60.0, 0.0, 0.0), 100.0)]
    number = int(rng.integers(2, 5))

    def hold(control: Control, chunks: list[PlanChunk], held: bool) -> None:
        if held:
            control.resume()
        elif len(chunks) == number:
            control.hold()

    times, rests = [], []
    for own in (mill, ringing(mill, {"x": (frequency, 0.03)})):
        motion, holds = driven(blocks, own, hold)
        before = motion[: holds[0]]
        assert motion[-1].positions(np.array([motion[-1].duration]))[0, 0] == pytest.approx(60.0)
        times.append(end_of(before) - end_of(motion[:number]))
        rests.append(residuals(before, [(0, frequency, 0.03)]).max())
    assert times[1] < times[0] + 1.5 / frequency
    assert rests[1] < 0.06 * rests[0] + 1e-5


def test_a_request_behind_a_rest_waits_for_the_end_of_the_shaped_motion() -> None:
    """The window rests already there; the last of the motion is not left out."""
    mill = ringing(machine(), {"x": (15.0, 0.05)})
    blocks: list[Block] = [lines((5.0, 0.0, 0.0)), Dwell("t.nc", 2, 0.1), lines((9.0, 0.0, 0.0))]
    for number in range(1, 12)[:: share(1, 2)]:

        def slower(control: Control, chunks: list[PlanChunk], held: bool, at: int = number) -> None:
            if len(chunks) == at:
                control.override(50.0)

        motion, _ = driven(blocks, mill, slower)
        ends = [plan.positions(np.array([plan.duration]))[0, 0] for plan in motion]
        assert ends[-1] == pytest.approx(9.0, abs=1e-9)
        rests = [end for end, plan in zip(ends, motion, strict=True) if plan.phase_v[-1] == 0.0]
        assert rests == pytest.approx([5.0, 9.0], abs=1e-9)


def test_a_machine_without_modes_is_planned_as_before() -> None:
    mill = machine()
    blocks: list[Block] = [lines((30.0, 10.0, 0.0)), arc((30.0, 10.0, 0.0), (30.0, 20.0), 0.5)]
    assert math.isclose(end_of(plans(blocks, ringing(mill, {}))), end_of(plans(blocks, mill)))
    assert not any(isinstance(item, Held) for item in LookAhead(mill).plan(path_of(blocks)))

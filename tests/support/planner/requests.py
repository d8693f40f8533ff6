"""Random programs and machines, with requests of the operator at random moments."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import corners, optimum_cases
from benchmarks.holds import state
from cnc.api import parse
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held, PathMode
from cnc.model.operator_control import Control
from cnc.path.chunk import PathChunk
from cnc.path.kernels.curve import LINE, curve_eval
from cnc.planner.kernels.timed import is_timed, timed_motion
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.session.pipeline import path_of
from tests.support.five_axis import TYPES, five_axis_machine, table_of
from tests.support.planner.random_jobs import Job, with_angles

Random = np.random.Generator


class Program(NamedTuple):
    """A program: its family, the path with the blocks between, and the machine.

    ``plans`` has the plans of runs without further requests, by the override: each is made once.
    """

    family: str
    path: list[PathChunk | Block]
    machine: Machine
    plans: dict[float, list[PlanChunk]]


def of_blocks(family: str, blocks: list[Block], machine: Machine) -> Program:
    """Return the program of blocks for the axes or the joints of a machine."""
    path = list(path_of(blocks, machine, np.zeros(len(machine.axis_names))))
    return Program(family, path, machine, {})


def rosette(rng: Random) -> list[Block]:
    """Return the chords of a rosette: a bent path without an end of its bends."""
    petals, size = int(rng.integers(3, 9)), 10 ** rng.uniform(0.8, 1.5)
    count = int(rng.integers(150, 700))
    u = np.linspace(0.0, 2.0 * math.pi * rng.uniform(0.3, 1.0), count)
    radius = size * (1.0 + rng.uniform(0.1, 0.6) * np.cos(petals * u))
    points = np.stack((radius * np.cos(u), radius * np.sin(u), np.zeros(count)), axis=1)
    points = (points - points[0]).round(int(rng.choice((3, 4))))
    tolerance = float(rng.choice((0.01, 0.003)))
    moves = optimum_cases.moves(points, optimum_cases.feed_of(rng))
    return [PathMode("", 1, "blend", tolerance), moves]


def polygon(rng: Random) -> tuple[list[Block], Machine]:
    """Return a polygon whose corners are passed within a tolerance."""
    case = corners.random_case(str(rng.choice(corners.FAMILIES)), rng)
    return corners.blocks_of(case), case.machine


PLANAR: dict[str, Callable[[Random], tuple[list[Block], Machine]]] = {
    **{name: family[0] for name, family in optimum_cases.FAMILIES.items()},
    "rosettes": lambda rng: (rosette(rng), optimum_cases.random_machine(rng)),
    "polygons": polygon,
}
FIVE_AXES = "five axes"
FAMILIES = (*PLANAR, FIVE_AXES)


def random_program(family: str, rng: Random, folder: Path) -> Program:
    """Return a random program of a family. Those of five axes are written to ``folder``."""
    if family != FIVE_AXES:
        return of_blocks(family, *PLANAR[family](rng))
    kind = str(rng.choice(TYPES))
    machine, file = five_axis_machine(kind, rng), folder / "five.ngc"
    file.write_text(with_angles(Job(rng, 8.0).write(), table_of(kind).tilting.upper(), rng))
    return of_blocks(family, list(parse(file, machine)), machine)


class Answer(NamedTuple):
    """What became of a request.

    Attributes:
        request: per cent of the feeds; 0 for a hold, and -1 for a stop.
        delay: motion that was handed out after the request, before it was planned, s.
        chain: time from the request to the end of the motion past corners that was under way, s.
        effect: time from the request until the motion keeps the feed, or rests, s; 0 for a request
            of a higher feed.
        ramp: time of the ramp to rest on a straight line along the slowest axis, s.
        behind: time by which the rest of the motion took longer than a run at that feed, s.
    """

    request: float
    delay: float
    chain: float
    effect: float
    ramp: float
    behind: float


def stop_time(v: float, machine: Machine) -> float:
    """Return the time of the ramp from a speed to rest along the slowest axis, s."""
    limits, own = Limits.of(machine), slice(Limits.of(machine).tip_columns, None)
    a = min(limits.tangential_acceleration, float(limits.axis_acceleration[own].min()))
    j = min(limits.tangential_jerk, float(limits.axis_jerk[own].min()))
    return _ramp(v, a, j)


def _ramp(v: float, a: float, j: float) -> float:
    return v / a + a / j if v * j >= a * a else 2.0 * math.sqrt(v / j)


def stop_time_of_joints(plan: PlanChunk, machine: Machine) -> float:
    """Return the longest time that a joint needs from its speed at the end of a plan to rest, s."""
    limits, joint = Limits.of(machine), Limits.of(machine).tip_columns
    speeds = np.abs(state(plan, plan.t0 + plan.duration)[0])[joint:].tolist()
    bounds = limits.axis_acceleration[joint:].tolist(), limits.axis_jerk[joint:].tolist()
    return max(
        _ramp(v, a, j) for v, a, j in zip(speeds, *bounds, strict=True) if max(a, j) < math.inf
    )


def plans_of(program: Program, percent: float) -> list[PlanChunk]:
    """Return the plans of a run at an override, without further requests."""
    if percent not in program.plans:
        items = LookAhead(program.machine, Control(percent)).plan(program.path)
        program.plans[percent] = [item for item in items if isinstance(item, PlanChunk)]
    return program.plans[percent]


def line_begins(plans: list[PlanChunk]) -> dict[int, float]:
    """Return the time at which the motion of each line begins, s."""
    begins: dict[int, float] = {}
    for plan in plans:
        at = np.maximum(plan.piece_s[:-1], plan.phase_s[0])
        times = plan.t0 + np.interp(at, plan.phase_s, plan.phase_t)
        for line, time in zip(plan.path.line.tolist(), times.tolist(), strict=True):
            begins.setdefault(line, time)
    return begins


def straights(plans: list[PlanChunk], line: int) -> list[tuple[float, np.ndarray]]:
    """Return the straight motion of a line: times, s, and places (axes,)."""
    points = []
    for plan in plans:
        for k in np.flatnonzero((plan.path.line == line) & (plan.path.kind == LINE)).tolist():
            low = max(float(plan.piece_s[k]), float(plan.phase_s[0]))
            high = min(float(plan.piece_s[k + 1]), float(plan.phase_s[-1]))
            inside = plan.phase_s[(plan.phase_s > low) & (plan.phase_s < high)].tolist()
            for s in (low, *inside, high):
                q = np.empty((4, len(plan.path.axes)))
                along = min(max(s - float(plan.piece_s[k]), 0.0), float(plan.path.length[k]))
                curve_eval(LINE, plan.path.data, int(plan.path.at[k]), along, q)
                time = plan.t0 + float(np.interp(s, plan.phase_s, plan.phase_t))
                points.append((time, q[0].copy()))
    return points


def begins_at_one_place(
    mine: list[PlanChunk], theirs: list[PlanChunk], line: int
) -> tuple[float, float]:
    """Return the times at which two runs are at one place, where both are on a line for the first.

    Past a corner the place at which a line begins depends on the speed, and the way too: so it is
    one on the straight, if the line is one in both.
    """
    here, there = straights(mine, line), straights(theirs, line)
    if len(here) < 2 or len(there) < 2:
        return line_begins(mine)[line], line_begins(theirs)[line]
    way = here[-1][1] - here[0][1]
    along = [[float((place - here[0][1]) @ way) for _, place in run] for run in (here, there)]
    first = max(each[0] for each in along)
    one, other = (
        float(np.interp(first, each, [time for time, _ in run]))
        for each, run in zip(along, (here, there), strict=True)
    )
    return one, other


def last_above(plan: PlanChunk, feeds: dict[int, float], factor: float) -> float | None:
    """Return the last time at which a plan is above its feeds times a factor, s; None for never."""
    path, count = plan.path, len(plan.path)
    # At its ends a phase may touch a piece with another coordinate.
    t = np.diff(plan.phase_t)[:, None] * np.linspace(0.01, 0.99, 9)
    s0, v0, a0 = (each[:-1, None] for each in (plan.phase_s, plan.phase_v, plan.phase_a))
    j = plan.phase_j[:, None]
    v = v0 + t * (a0 + t * j / 2)
    s = s0 + t * (v0 + t * (a0 / 2 + t * j / 6))
    piece = np.clip(np.searchsorted(plan.piece_s, s, side="right") - 1, 0, count - 1)
    programmed = np.array([feeds.get(line, math.inf) for line in path.line.tolist()])
    timed = [is_timed(k, path.data, at) for k, at in zip(path.kind, path.at, strict=True)]
    q = np.empty((4, len(path.axes)))
    for place in np.argwhere(np.array(timed)[piece]):
        k, at = piece[*place], int(path.at[piece[*place]])
        u = min(max(float(s[*place] - plan.piece_s[k]), 0.0), float(path.length[k]))
        curve_eval(int(path.kind[k]), path.data, at, u, q)
        v[*place] = timed_motion(path.data, at, q, v[*place], 0.0, 0.0)[0]
    # At the end of a piece the feed of either side counts.
    before, after = np.maximum(piece - 1, 0), np.minimum(piece + 1, count - 1)
    highest = np.maximum(programmed[piece], np.maximum(programmed[before], programmed[after]))
    above = np.argwhere(v > highest * factor * (1.0 + 1e-3))
    if not len(above):
        return None
    phase, point = above[-1].tolist()
    return plan.t0 + float(plan.phase_t[phase]) + float(t[phase, point])


def feeds_of(program: Program) -> dict[int, float]:
    """Return the largest feed of each line, mm/s; infinite for a traverse."""
    feeds: dict[int, float] = {}
    for item in program.path:
        if isinstance(item, PathChunk):
            for line, feed in zip(item.line.tolist(), item.feed.tolist(), strict=True):
                feeds[line] = max(feeds.get(line, 0.0), math.inf if math.isnan(feed) else feed)
    return feeds


REQUESTS = (-1.0, 0.0, 0.0, 1.0, 10.0, 25.0, 50.0, 70.0, 90.0, 120.0, 200.0)
"""Per cent of the feeds; 0 for a hold, and -1 for a stop."""


def answered(
    program: Program, rng: Random, requests: Sequence[float] = REQUESTS, inside: float = 0.0
) -> Answer | None:
    """Make a request at a random moment of a run, and return what became of it.

    Args:
        program: the program.
        rng: the source of moment and request.
        requests: those to choose from.
        inside: the request waits for a motion past corners that lasts so long, s.

    Returns:
        None where the program has no motion, or rests at that moment.
    """
    feeds = feeds_of(program)
    first = float(rng.choice((100.0, 100.0, 30.0, 60.0)))
    plain = plans_of(program, first)
    if not plain:
        return None
    request = float(rng.choice(requests))
    moment = rng.uniform(0.0, plain[-1].t0 + plain[-1].duration)
    control = Control(first)
    ahead = LookAhead(program.machine, control)
    requested = planned = chain = ramp = effect = math.nan
    end, rested, sent = 0.0, math.nan, []
    for item in ahead.plan(program.path):
        if isinstance(item, Held):
            rested = end if math.isnan(rested) else rested
            planned = min(requested if math.isnan(planned) else planned, end)
            control.resume()
            continue
        if not isinstance(item, PlanChunk):
            continue
        if requested == requested and math.isnan(planned):
            wanted = max(request, 0.0) / 100.0
            planned = end if ahead.feed_factor == wanted else math.nan
        sent.append(item)
        end = item.t0 + item.duration
        if requested == requested:
            above = last_above(item, feeds, request / 100.0) if request > 0.0 else None
            effect = effect if above is None else above
        elif end >= moment and ahead.chain_left >= inside:
            v = float(np.abs(item.phase_v).max())
            if item.phase_v[-1] == 0.0:
                return None
            requested, chain = end, ahead.chain_left
            ramp = stop_time(v, program.machine)
            if program.family == FIVE_AXES:
                ramp = max(ramp, stop_time_of_joints(item, program.machine))
            if request < 0.0:
                sent += list(ahead.ramp_down())
                rested = sent[-1].t0 + sent[-1].duration
                return Answer(request, 0.0, chain, rested - requested, ramp, 0.0)
            if request == 0.0:
                control.hold()
            else:
                control.override(request)
    if math.isnan(requested):
        return None
    planned = end if math.isnan(planned) else planned
    if request == 0.0:
        effect = end if math.isnan(rested) else rested
    effect = requested if math.isnan(effect) else effect
    behind = 0.0
    at_feed = plans_of(program, request or first)
    mine, theirs = line_begins(sent), line_begins(at_feed)
    after = [line for line, time in mine.items() if time >= effect and line in theirs]
    if after:
        line = min(after, key=mine.__getitem__)
        last = at_feed[-1].t0 + at_feed[-1].duration
        one, other = begins_at_one_place(sent, at_feed, line)
        behind = (end - one) - (last - other)
    return Answer(request, planned - requested, chain, effect - requested, ramp, behind)

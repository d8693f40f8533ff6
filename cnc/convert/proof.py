"""Proof of a conversion: both programs are read, and their blocks compared one by one.

The position before the program and the work offsets are not known. In all readings they are made
up, and the proof has others than the writer had. So a result that counts on them is seen, and so is
one that selects the wrong offset, or leaves out a move that an offset of 0 would not need.

    program ──► elements ─┬─ straight moves, arcs: one by one, ends and shapes
    result  ──► elements ─┘  curves written within the tolerance: distance of both ways
                             actions: the same, in the same place
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cnc.compare.programs import Track, farthest, points_along
from cnc.convert.elements import Elements, Straights, as_blocks, size
from cnc.convert.target import Target
from cnc.convert.writer import Region
from cnc.gcode.core.coordinates import EXTERNAL
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import (
    PLANE_AXES,
    AnalogOutput,
    ArcFeed,
    Block,
    BoardCommand,
    Coolant,
    DigitalOutput,
    Dwell,
    End,
    Message,
    NurbsFeed,
    Orient,
    Overrides,
    PathMode,
    Probe,
    Spindle,
    SpindleSync,
    Stop,
    Tool,
    WaitInput,
)
from cnc.path.build import exact_path
from cnc.path.chunk import PathChunk

SAME = 1e-3
"""mm. Largest distance of moves that are the same."""
SAME_FEED, SAME_SPEED, SAME_TIME = 1e-5, 1e-5, 1e-3
"""Largest relative differences of feeds and speeds; seconds of dwells."""
SAME_PITCH = 1e-8
"""mm. Largest difference of the pitches of threads."""
SPACING = 0.02
"""mm between points on curves, of which the distance is measured."""

Floats = NDArray[np.float64]


class Differs(Exception):
    """Both programs differ at a line of the result.

    Attributes:
        line: The line of the result; 0 if it ends before.
        source: The line of the program; 0 if it ends before.
        what: The difference.
    """

    def __init__(self, source: Block | None, result: Block | None, what: str) -> None:
        self.source = 0 if source is None else source.line
        self.line = 0 if result is None else result.line
        self.what = what
        super().__init__(what)


def made_up_start(axes: int, version: int) -> Floats:
    """Return a position (axes,) before the program, mm, that no program would move to."""
    return np.array([0.7131 + 0.3717 * version + 1.137 * axis for axis in range(axes)])


def made_up_offsets(version: int) -> dict[int, float]:
    """Return parameters in which each coordinate system has another origin.

    Args:
        version: Number of the set; another set has all other values.
    """
    return {
        _first(system) + axis: round(
            (17.0 + 3.25 * system - 1.5 * axis + 0.011 * system * axis) * (1.0 + 0.17 * version), 3
        )
        for system in range(9 + numbers.MOST_G54_1_SYSTEMS)
        for axis in range(numbers.AXES_PER_PLACE)
    }


def with_other_systems(
    values: dict[int, float], systems: dict[int, int], plain: int
) -> dict[int, float]:
    """Return the parameters of a result that uses other coordinate systems.

    Args:
        values: Those of the program.
        systems: Coordinate system of the result for each one of the program that has another.
        plain: Number of the program's coordinate systems before those of G54.1.
    """
    result = dict(values)
    for system, other in systems.items():
        first = _first(system if system < plain else 9 + system - plain)
        for axis in range(numbers.AXES_PER_PLACE):
            # The basic system (G500) has no offset of its own.
            value = 0.0 if system == EXTERNAL else values[first + axis]
            result[numbers.origin(other) + axis] = value
    return result


def _first(system: int) -> int:
    """Return the first parameter of G54 (0) to G59.3 (8), or of G54.1 (from 9)."""
    if system < 9:
        return numbers.origin(system)
    return numbers.G54_1_ORIGIN + numbers.SYSTEM_STEP * (system - 9)


class _Cursor:
    """Elements of one program, of which parts are taken."""

    def __init__(self, blocks: Iterable[Block], start: Floats, target: Target) -> None:
        elements = Elements(start).of(blocks)
        self._elements = _without_idle_speeds(elements) if target.is_lathe else elements
        self._target = target
        self._path: tuple[str, float] | None = None
        self._spindle: list[object] = []
        self._coolant: list[object] = []
        self._tool: int | None = None
        self._overrides = (True, True)
        self.position = start
        self.curves = 0
        self.current: Block | None = None
        self._next()

    def _next(self) -> None:
        for element in self._elements:
            if self._is_compared(element):
                self.current = element
                return
        self.current = None

    def _is_compared(self, element: Block) -> bool:
        """Whether an action means something on the target."""
        if isinstance(element, PathMode):
            rules, before = self._target.rules.motion, self._path
            if not self._target.path_code(element.control):
                return False
            tolerance = element.tolerance if "P" in rules.path_words else 0.0
            self._path = element.control, tolerance
            return self._path != before
        if isinstance(element, Coolant):
            coolant, self._coolant = self._coolant, _values(element)
            return self._coolant != coolant
        if isinstance(element, Spindle) and self._target.is_lathe:
            # A turret leaves the spindle as it is, and so does a start at the speed that it has.
            spindle, self._spindle = self._spindle, _values(element)
            return self._spindle != spindle
        if isinstance(element, End):
            return bool(self._target.ends())
        if isinstance(element, Tool) and self._target.is_lathe:
            # A turret does not turn to the tool that it has.
            tool, self._tool = self._tool, element.number
            return tool != element.number
        if isinstance(element, Overrides):
            allowed = element.feed, element.spindle
            if not self._target.has_overrides(*allowed) or self._overrides == allowed:
                return False
            self._overrides = allowed
        return not isinstance(element, Message)

    def take(self, count: int = 1) -> Block:
        """Take the first moves of the current element, or the element."""
        element = self.current
        assert element is not None
        if isinstance(element, Straights):
            part = element.part(0, count)
            self.position = part.points[-1]
            self.curves += count
            if count < len(element):
                self.current = element.part(count)
            else:
                self._next()
            return part
        self.curves += size(element)
        if isinstance(element, ArcFeed | Probe):
            self.position = element.end
        elif isinstance(element, NurbsFeed):
            self.position = element.control_points[-1]
        self._next()
        return element

    def coolant(self) -> tuple[bool, bool] | None:
        """Take coolant commands that follow each other; return the state behind them."""
        state = None
        while isinstance(self.current, Coolant):
            state = self.current.mist, self.current.flood
            self._next()
        return state


def _without_idle_speeds(elements: Iterable[Block]) -> Iterator[Block]:
    """Yield elements without a speed of the spindle that the next one replaces at once.

    FANUC's limit of the speed is a line of its own, which a turning spindle follows.
    """
    speed: Block | None = None
    for element in elements:
        turns = isinstance(element, Spindle) and element.state != "off"
        if speed is not None and not turns:
            yield speed
        speed = element if turns else None
        if not turns:
            yield element
    if speed is not None:
        yield speed


def distance(
    program: Iterable[Block],
    result: Iterable[Block],
    start: Floats,
    axes: tuple[str, ...],
    regions: Sequence[Region],
    target: Target,
) -> tuple[float, float]:
    """Return the largest distances of kept moves and of curves within the tolerance, mm.

    Args:
        program: Blocks of the program.
        result: Blocks of the result.
        start: Position before both (axes,), mm.
        axes: Letters of the axes.
        regions: Curves that were written within a tolerance.
        target: The control.

    Raises:
        Differs: They differ otherwise than by a distance.
    """
    one, other = _Cursor(program, start, target), _Cursor(result, start, target)
    worst = of_regions = 0.0
    ahead = iter(regions)
    region = next(ahead, None)
    turning: Spindle | None = None
    while one.current is not None:
        if region is not None and one.curves == region.first and size(one.current):
            of_regions = max(of_regions, _region(one, other, region, axes))
            region = next(ahead, None)
            continue
        if other.current is None:
            if isinstance(one.current, Coolant | Stop | End | Spindle):
                raise Differs(one.current, None, "an action is missing at the end")
            raise Differs(one.current, None, "a move is missing at the end")
        most = None if region is None else region.first - one.curves
        if isinstance(one.current, Straights) and isinstance(other.current, Straights):
            worst = max(worst, _straights(one, other, most))
        elif isinstance(one.current, Coolant) and isinstance(other.current, Coolant):
            places = one.current, other.current
            if one.coolant() != other.coolant():
                raise Differs(*places, "the coolant differs")
        elif (
            target.is_lathe and isinstance(one.current, Tool) and isinstance(other.current, Spindle)
        ):
            _change_with_stop(one, other, turning, target)
        else:
            if isinstance(one.current, Spindle):
                turning = one.current
            worst = max(worst, _single(one.take(), other.take(), target, axes))
    while other.current is not None:
        if not isinstance(other.current, End):
            raise Differs(None, other.current, "the result does more")
        other.take()
    return worst, of_regions


def _change_with_stop(
    one: _Cursor, other: _Cursor, turning: Spindle | None, target: Target
) -> None:
    """Compare the turn of a turret with a change that stops the spindle and starts it again."""
    tool, first = one.take(), other.take()
    assert isinstance(first, Spindle)
    restarted = one.current
    at_once = isinstance(restarted, Spindle) and restarted.state != "off"
    # A start at the old speed, which the new one replaces at once, is left out.
    for block in (tool,) if at_once else (tool, turning):
        current = other.current
        if first.state != "off" or block is None or current is None:
            raise Differs(tool, first, f"{type(tool).__name__} became {type(first).__name__}")
        if not _same_action(block, other.take(), target):
            raise Differs(tool, current, "the spindle differs behind the change of the tool")


def _straights(one: _Cursor, other: _Cursor, most: int | None) -> float:
    """Compare the moves that both have next; return their largest distance."""
    assert isinstance(one.current, Straights)
    assert isinstance(other.current, Straights)
    count = min(len(one.current), len(other.current))
    if most is not None:
        count = min(count, most)
    a, b = one.take(count), other.take(count)
    assert isinstance(a, Straights)
    assert isinstance(b, Straights)
    apart = np.abs(a.points - b.points).max(axis=1)
    far = apart > SAME
    feeds = ~np.isclose(a.feeds, b.feeds, rtol=SAME_FEED, atol=0.0, equal_nan=True)
    if (far | feeds).any():
        at = int(np.argmax(far | feeds))
        what = f"the ends are {apart[at]:.6g} mm apart" if far[at] else "the feeds differ"
        raise Differs(a.part(at), b.part(at), what)
    return float(apart.max())


def _single(a: Block, b: Block, target: Target, axes: tuple[str, ...]) -> float:
    """Compare arcs or actions; return the distance of arcs."""
    if isinstance(a, ArcFeed) and isinstance(b, ArcFeed):
        apart = max(
            float(np.abs(a.end - b.end).max()),
            math.dist(a.center, b.center)
            + abs(a.radius - b.radius)
            + 2.0 * math.pi * a.radius * abs(a.turns - b.turns),
        )
        if a.plane != b.plane or apart > SAME:
            raise Differs(a, b, f"the arcs are {apart:.6g} mm apart")
        if not math.isclose(a.feed, b.feed, rel_tol=SAME_FEED):
            raise Differs(a, b, "the feeds differ")
        return apart
    if isinstance(a, Probe) and isinstance(b, Probe):
        apart = float(np.abs(a.end - b.end).max())
        if (a.towards, a.must) != (b.towards, b.must) or apart > SAME:
            raise Differs(a, b, "the probing moves differ")
        return apart
    if not _same_action(a, b, target):
        raise Differs(a, b, f"{type(a).__name__} became {type(b).__name__}")
    return 0.0


def _same_action(a: Block, b: Block, target: Target) -> bool:
    """Whether two actions are the same on the target."""
    match a, b:
        case Tool(change=True), Stop(optional=False):
            return not target.tool_change
        case Tool(), Tool():
            return (a.number, a.change) == (b.number, b.change)
        case Spindle(), Spindle():
            return (
                a.state == b.state
                and a.with_motion == b.with_motion
                and math.isclose(a.surface_speed, b.surface_speed, rel_tol=SAME_SPEED)
                and math.isclose(a.least_rpm, b.least_rpm, rel_tol=SAME_SPEED)
                and (a.state == "off" or math.isclose(a.rpm, b.rpm, rel_tol=SAME_SPEED))
            )
        case Dwell(), Dwell():
            return math.isclose(a.seconds, b.seconds, rel_tol=SAME_FEED, abs_tol=SAME_TIME)
        case Stop(), Stop():
            return (a.optional, a.pallet) == (b.optional, b.pallet)
        case End(), End():
            return True
        case PathMode(), PathMode():
            return a.control == b.control and (
                "P" not in target.rules.motion.path_words
                or math.isclose(a.tolerance, b.tolerance, abs_tol=1e-5)
            )
        case (Overrides(), Overrides()):
            return (a.feed, a.spindle) == (b.feed, b.spindle)
        case SpindleSync(), SpindleSync():
            return a.angle == b.angle and math.isclose(a.pitch, b.pitch, abs_tol=SAME_PITCH)
        case BoardCommand(), BoardCommand():
            return a.text == b.text
        case (
            (Orient(), Orient())
            | (DigitalOutput(), DigitalOutput())
            | (AnalogOutput(), AnalogOutput())
            | (WaitInput(), WaitInput())
        ):
            return _values(a) == _values(b)
    return False


def _values(block: Block) -> list[object]:
    """Return all values of a block but its place and its answer."""
    names = (name for kind in type(block).__mro__ for name in getattr(kind, "__slots__", ()))
    return [getattr(block, name) for name in names if name not in ("file", "line", "answer")]


def _region(one: _Cursor, other: _Cursor, region: Region, axes: tuple[str, ...]) -> float:
    """Return the distance of curves of the program from those that stand for them."""
    start, begin = one.position, one.current
    of_program = list(_curves(one, region.last))
    of_result = list(_lines(other, region))
    feeds = [_feeds(elements) for elements in (of_program, of_result)]
    if not of_result or not np.allclose(feeds[0], feeds[1], rtol=SAME_FEED, atol=0.0):
        raise Differs(begin, of_result[0] if of_result else None, "the feeds differ")
    curved = any(isinstance(curve, ArcFeed | NurbsFeed) for curve in of_program)
    if len(of_result) == 1 and not curved:
        moves = [element for element in of_program if isinstance(element, Straights)]
        points = np.concatenate([start[None], *(run.points for run in moves)])
        if not isinstance(of_result[0], NurbsFeed):
            return _from_curve(points, of_result[0], axes)
        apart = _from_chords(points, _track(of_result, start, axes).points)
        if apart is not None:
            return apart
    tracks = [_track(elements, start, axes) for elements in (of_program, of_result)]
    return farthest(*tracks).distance


PARTS = 8
"""Places on each straight move at which its distance is measured."""


def _from_curve(points: Floats, curve: Block, axes: tuple[str, ...]) -> float:
    """Return the distance of straight moves through points from one curve of the result, mm.

    The places on the moves must follow each other on the curve, and both ends are compared. So the
    distance is that of the curve from the moves, too.

    Args:
        points: Points (n, axes) from the start on.
        curve: An arc, or a straight move.
        axes: Letters of the axes.
    """
    places = _places(points)
    end = curve.points[-1] if isinstance(curve, Straights) else getattr(curve, "end", points[-1])
    apart = float(np.linalg.norm(points[-1] - end))
    if not isinstance(curve, ArcFeed):
        way = end - points[0]
        along = (places - points[0]) @ way / max(float(way @ way), 1e-300)
        on_curve = points[0] + np.clip(along, 0.0, 1.0)[:, None] * way
        length = float(np.linalg.norm(way))
    else:
        i, j = (axes.index(axis) for axis in PLANE_AXES[curve.plane])
        x, y = places[:, i] - curve.center[0], places[:, j] - curve.center[1]
        turned = np.unwrap(np.arctan2(y, x))
        along = (turned - turned[0]) / (2.0 * math.pi * curve.turns)
        on_curve = points[0] + np.clip(along, 0.0, 1.0)[:, None] * (end - points[0])
        angle = turned[0] + np.clip(along, 0.0, 1.0) * 2.0 * math.pi * curve.turns
        on_curve[:, i] = curve.center[0] + curve.radius * np.cos(angle)
        on_curve[:, j] = curve.center[1] + curve.radius * np.sin(angle)
        length = 2.0 * math.pi * curve.radius * abs(curve.turns)
    # A way back is as far from the curve as it is long.
    back = float((np.maximum.accumulate(along) - along).max()) * length
    return max(apart, back, float(np.linalg.norm(places - on_curve, axis=1).max()))


NEAR = 0.03
"""Part of a curve on which the place next to one of the program is sought."""


def _from_chords(points: Floats, chords: Floats) -> float | None:
    """Return the distance of straight moves through points from short chords of a curve, mm.

    It is measured as by :func:`_from_curve`. A place on the moves is compared with the chords at
    about the same part of the length.

    Args:
        points: Points (n, axes) from the start on.
        chords: Points (m, axes) on the curve, from its start on.

    Returns:
        None if the next chord may be another one.
    """
    places = _places(points)
    begins, steps = chords[:-1], np.diff(chords, axis=0)
    squares = np.maximum(np.einsum("ij,ij->i", steps, steps), 1e-300)
    reach = int(NEAR * len(steps)) + 4
    guess = np.searchsorted(_shares(chords), _shares(places), side="right") - 1
    best = np.full(len(places), np.inf)
    chord, share = np.zeros(len(places), np.int64), np.zeros(len(places))
    for offset in range(-reach, reach + 1):
        k = np.clip(guess + offset, 0, len(steps) - 1)
        apart = places - begins[k]
        part = np.clip(np.einsum("ij,ij->i", apart, steps[k]) / squares[k], 0.0, 1.0)
        apart -= part[:, None] * steps[k]
        square = np.einsum("ij,ij->i", apart, apart)
        nearer = square < best
        best[nearer], chord[nearer], share[nearer] = square[nearer], k[nearer], part[nearer]
    inside = (chord > 0) & (chord < len(steps) - 1)
    if (inside & (np.abs(chord - guess) == reach)).any():
        return None
    lengths = np.sqrt(squares)
    way = np.concatenate(([0.0], np.cumsum(lengths)))[chord] + share * lengths[chord]
    back = float((np.maximum.accumulate(way) - way).max())
    ends = [float(np.linalg.norm(points[k] - chords[k])) for k in (0, -1)]
    return max(back, *ends, math.sqrt(float(best.max())))


def _places(points: Floats) -> Floats:
    """Return places on straight moves through points, PARTS on each, and the end."""
    share = np.arange(PARTS) / PARTS
    places = points[:-1, None] + share[None, :, None] * np.diff(points, axis=0)[:, None]
    return np.concatenate((places.reshape(-1, points.shape[1]), points[-1:]))


def _shares(points: Floats) -> Floats:
    """Return the part of the length at each point (n,), from 0 to 1."""
    along = np.cumsum(np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1))
    shares: Floats = along / max(float(along[-1]), 1e-300)
    return shares


def _curves(cursor: _Cursor, last: int) -> Iterator[Block]:
    """Take curves up to a number."""
    while cursor.current is not None and cursor.curves < last:
        if not size(cursor.current):
            raise Differs(cursor.current, None, "an action stands among curves")
        yield cursor.take(
            min(last - cursor.curves, len(cursor.current))
            if isinstance(cursor.current, Straights)
            else 1
        )


def _lines(cursor: _Cursor, region: Region) -> Iterator[Block]:
    """Take the curves of the lines of a region."""
    while (current := cursor.current) is not None and current.line <= region.end:
        if isinstance(current, Straights):
            yield cursor.take(int(np.searchsorted(current.lines, region.end, side="right")))
        elif size(current):
            yield cursor.take()
        else:
            return


def _feeds(elements: list[Block]) -> list[float]:
    """Return the lowest and the highest feed."""
    feeds = np.concatenate(
        [
            element.feeds if isinstance(element, Straights) else [getattr(element, "feed", np.nan)]
            for element in elements
        ]
        or [np.zeros(1)]
    )
    return [float(feeds.min()), float(feeds.max())]


def _track(elements: list[Block], start: Floats, axes: tuple[str, ...]) -> Track:
    """Return points along curves."""
    points = [start[None]]
    for item in exact_path(as_blocks(elements), axes=axes, start=start):
        if isinstance(item, PathChunk):
            points.append(points_along(item, SPACING)[0])
    joined = np.concatenate(points)
    nothing = np.zeros(len(joined), np.int64)
    return Track(joined, nothing, nothing, ("",))

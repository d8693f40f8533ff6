"""Programs of simple jobs: their parameters, and the lines that cut them.

    written("round-pocket", {"bore": 30, "depth": 6})

Each program uses G0, G1, G3, G4 and drilling cycles alone, so most dialects read it. Lengths are
in mm in the coordinate system in use, Z 0 is the surface. Inner walls are cut counter-clockwise: a
spindle that turns clockwise climbs there.

    pocket, each depth       helix or ramp down, then rings from the inside to the wall
    slot, each depth         ramp down on its centre line, then rings
    surfacing, each depth    rows that begin and end beside the area, so the tool goes down in air
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from cnc.gcode.dialects import Dialect, load
from cnc.gcode.reader.words import G, M
from cnc.model.choices import DialectName
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.units import decimal_text
from cnc.simple_jobs.lettering import letters, strokes

MOST_LINES = 100_000
"""Lines of a program."""
RAMP = math.tan(math.radians(3.0))
"""Slope of a ramp or a helix into the material."""
HELIX = 0.4
"""Radius of a helix in diameters of the tool: below 0.5, so that no core stays."""
LEAST_HELIX = 0.05
"""Radius of the smallest helix, in diameters of the tool. A narrower pocket is a hole."""
FIRST_CODES = (G.G21, G.G90, G.G17, G.G94, G.G40, G.G49, G.G80)
"""Codes that set what the program relies on."""
ABOVE = 1.0
"""Distance from the surface at which a drill begins to feed, mm."""

Place = Annotated[FiniteFloat, Field(ge=-5000.0, le=5000.0)]
Length = Annotated[FiniteFloat, Field(gt=0.0, le=5000.0)]
Speed = Annotated[FiniteFloat, Field(gt=0.0, le=100_000.0)]


class SimpleJob(BaseModel, ABC):
    """Parameters of all jobs.

    Raises:
        UsageError: ``job-parameter``, by :meth:`lines`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    kind: ClassVar[str]
    title: ClassVar[str]
    tool_kind: ClassVar[str] = "flat end mill"

    tool: int = Field(default=1, ge=0, le=9999, title="tool; 0 keeps the one in the spindle")
    diameter: Length = Field(default=6.0, title="diameter of the tool, mm")
    speed: Speed = Field(default=10000.0, title="spindle, rev/min")
    spin_up: FiniteFloat = Field(
        default=3.0, ge=0.0, le=60.0, title="time for the spindle to reach its speed, s"
    )
    feed: Speed = Field(default=600.0, title="feed, mm/min")
    plunge: Speed = Field(default=200.0, title="feed into the material, mm/min")
    clear: Length = Field(default=5.0, title="Z of the moves between cuts, mm")
    depth: Length = Field(default=2.0, title="depth, mm")

    @abstractmethod
    def cuts(self) -> Iterator[str]:
        """Yield the lines of the cuts. The tool is at ``clear`` before and after them."""

    def lines(self, dialect: Dialect) -> Iterator[str]:
        """Yield the lines of the program, for a control with a dialect."""
        yield f"({self.title}, depth {_n(self.depth)} mm. Zero of Z: the surface)"
        if self.tool:
            yield f"(T{self.tool} D={_n(self.diameter)} - {self.tool_kind})"
        # G49: a length of the tool table would count a second time.
        yield "(Set Z 0 with this tool. No tool length of a table is used)"
        first = [code for code in FIRST_CODES if code in dialect.g]
        yield " ".join(dialect.spelled.get(code.code, [code.name])[-1] for code in first)
        if self.tool:
            yield f"T{self.tool} M6"
        yield f"S{_n(self.speed)} M3"
        if self.spin_up:
            yield dialect.dwell.line(self.spin_up)
        yield f"G0 Z{_n(self.clear)}"
        yield from self.cuts()
        yield f"G0 Z{_n(self.clear)}"
        yield "M5"
        if M.M30 in dialect.m:
            yield "M30"


class Milled(SimpleJob):
    """A job that is milled in several depths."""

    step_down: Length = Field(default=1.0, title="depth of one pass, mm")
    step_over: FiniteFloat = Field(
        default=40.0, ge=5.0, le=80.0, title="width of one pass, % of the diameter"
    )

    @property
    def step(self) -> float:
        """Width of one pass, mm. Above 85 % of the diameter corners between rings would stay."""
        return self.step_over / 100.0 * self.diameter

    def levels(self) -> list[tuple[float, float]]:
        """Return Z before and in each pass, mm."""
        count = _count(self.depth, self.step_down)
        return [(-self.depth * k / count, -self.depth * (k + 1) / count) for k in range(count)]

    def rings(self, first: float, last: float) -> list[float]:
        """Return the distances of rings, from one behind ``first`` to ``last``."""
        count = _count(last - first, self.step) if last - first > 1e-9 else 0
        return [first + (last - first) * (k + 1) / count for k in range(count)]


class Surfacing(Milled):
    """A flat surface."""

    kind = "surfacing"
    title = "Surfacing"

    x: Place = Field(default=0.0, title="left side, X mm")
    y: Place = Field(default=0.0, title="front side, Y mm")
    width: Length = Field(default=100.0, title="width in X, mm")
    length: Length = Field(default=60.0, title="length in Y, mm")
    depth: Length = Field(default=0.5, title="depth, mm")
    overrun: Length = Field(default=2.0, title="way beyond the sides in X, mm")

    def cuts(self) -> Iterator[str]:
        """Yield rows along X. The centres of the first and last row lie on the sides."""
        left = self.x - self.diameter / 2.0 - self.overrun
        right = self.x + self.width + self.diameter / 2.0 + self.overrun
        rows = [self.y, *(self.y + way for way in self.rings(0.0, self.length))]
        for _, level in self.levels():
            yield f"G0 Z{_n(self.clear)}"
            yield f"G0 {_xy((left, rows[0]))}"
            yield f"G1 Z{_n(level)} F{_n(self.plunge)}"
            for k, row in enumerate(rows):
                if k:
                    yield f"G1 Y{_n(row)}"
                yield f"G1 X{_n(left if k % 2 else right)} F{_n(self.feed)}"


class RectangularPocket(Milled):
    """A pocket with sides along X and Y. Its corners have the radius of the tool."""

    kind = "rectangular-pocket"
    title = "Rectangular pocket"

    x: Place = Field(default=0.0, title="left side, X mm")
    y: Place = Field(default=0.0, title="front side, Y mm")
    width: Length = Field(default=40.0, title="width in X, mm")
    length: Length = Field(default=30.0, title="length in Y, mm")

    def cuts(self) -> Iterator[str]:
        """Yield a line in the middle, then rectangles around it."""
        half = [(side - self.diameter) / 2.0 for side in (self.width, self.length)]
        if min(half) < 0.0:
            raise _wrong("the pocket is narrower than the tool", "take a thinner tool")
        least = min(half)
        # Half of the line in the middle, along the longer side.
        ends = [side - least for side in half]
        x, y = self.x + self.width / 2.0, self.y + self.length / 2.0
        begin, end = (x - ends[0], y - ends[1]), (x + ends[0], y + ends[1])
        helix = min(least, HELIX * self.diameter)
        for depths in self.levels():
            if helix >= LEAST_HELIX * self.diameter:
                yield from _helix(self, (x, y), helix, depths)
                yield f"G1 {_xy(begin)} F{_n(self.feed)}"
            else:
                yield from _ramp(self, begin, end, depths)
            if begin != end:
                yield f"G1 {_xy(end)} F{_n(self.feed)}"
                yield f"G1 {_xy(begin)}"
            for ring in self.rings(0.0, least):
                low = (begin[0] - ring, begin[1] - ring)
                high = (end[0] + ring, end[1] + ring)
                yield f"G1 {_xy(low)}"
                yield f"G1 X{_n(high[0])}"
                yield f"G1 Y{_n(high[1])}"
                yield f"G1 X{_n(low[0])}"
                yield f"G1 Y{_n(low[1])}"
            # Away from the wall, so that going up leaves no mark.
            yield f"G1 {_xy(begin)}"


class RoundPocket(Milled):
    """A round pocket."""

    kind = "round-pocket"
    title = "Round pocket"

    x: Place = Field(default=0.0, title="centre, X mm")
    y: Place = Field(default=0.0, title="centre, Y mm")
    bore: Length = Field(default=30.0, title="diameter of the pocket, mm")

    def cuts(self) -> Iterator[str]:
        """Yield a helix in the middle, then circles around it."""
        wall = (self.bore - self.diameter) / 2.0
        if wall < LEAST_HELIX * self.diameter:
            least = _n((1.0 + 2.0 * LEAST_HELIX) * self.diameter)
            message = f"the tool is too thick for a helix: the pocket needs {least} mm"
            raise _wrong(message, "take a thinner tool, or drill it")
        centre, helix = (self.x, self.y), min(wall, HELIX * self.diameter)
        for depths in self.levels():
            yield from _helix(self, centre, helix, depths)
            for n, ring in enumerate(self.rings(helix, wall)):
                yield f"G1 X{_n(self.x + ring)}" + (f" F{_n(self.feed)}" if n == 0 else "")
                yield f"G3 {_xy((self.x + ring, self.y))} I{_n(-ring)} J0"
            yield f"G1 {_xy(centre)} F{_n(self.feed)}"


class Slot(Milled):
    """A slot with round ends."""

    kind = "slot"
    title = "Slot"

    x: Place = Field(default=0.0, title="centre of the first end, X mm")
    y: Place = Field(default=0.0, title="centre of the first end, Y mm")
    x_end: Place = Field(default=40.0, title="centre of the second end, X mm")
    y_end: Place = Field(default=0.0, title="centre of the second end, Y mm")
    width: Length = Field(default=10.0, title="width, mm")

    def cuts(self) -> Iterator[str]:
        """Yield the centre line, then rings around it."""
        wall = (self.width - self.diameter) / 2.0
        way = math.hypot(self.x_end - self.x, self.y_end - self.y)
        if wall < 0.0:
            raise _wrong("the slot is narrower than the tool", "take a thinner tool")
        if way < self.diameter / 2.0:
            raise _wrong("the ends of the slot are closer than the tool's radius", "bore it")
        begin, end = (self.x, self.y), (self.x_end, self.y_end)
        # To the right of the way from the first to the second end.
        right = ((self.y_end - self.y) / way, (self.x - self.x_end) / way)
        for depths in self.levels():
            yield from _ramp(self, begin, end, depths)
            yield f"G1 {_xy(end)} F{_n(self.feed)}"
            yield f"G1 {_xy(begin)}"
            for ring in self.rings(0.0, wall):
                i, j = ring * right[0], ring * right[1]
                first = _xy((begin[0] + i, begin[1] + j))
                yield f"G1 {first}"
                yield f"G1 {_xy((end[0] + i, end[1] + j))}"
                yield f"G3 {_xy((end[0] - i, end[1] - j))} I{_n(-i)} J{_n(-j)}"
                yield f"G1 {_xy((begin[0] - i, begin[1] - j))}"
                yield f"G3 {first} I{_n(i)} J{_n(j)}"
            yield f"G1 {_xy(begin)}"


class Holes(SimpleJob):
    """Holes that are drilled."""

    tool_kind = "drill"

    depth: Length = Field(default=5.0, title="depth of the tip, mm")
    peck: FiniteFloat = Field(
        default=2.0, ge=0.0, le=5000.0, title="depth of one peck, mm; 0 for none"
    )

    @abstractmethod
    def places(self) -> list[tuple[float, float]]:
        """Return the centres of the holes, mm."""

    def cuts(self) -> Iterator[str]:
        """Yield a drilling cycle at each place."""
        if self.clear <= ABOVE:
            raise _wrong(f"clear must be more than {_n(ABOVE)} mm above the holes", "such as 5")
        pecks = 0.0 < self.peck < self.depth
        cycle = f"G98 {'G83' if pecks else 'G81'} Z{_n(-self.depth)} R{_n(ABOVE)}"
        words = f"{cycle}{f' Q{_n(self.peck)}' if pecks else ''} F{_n(self.plunge)}"
        for k, (x, y) in enumerate(self.places()):
            yield f"{'' if k else words + ' '}{_xy((x, y))}"
        yield "G80"


class HoleGrid(Holes):
    """Holes in columns and rows."""

    kind = "hole-grid"
    title = "Holes in columns and rows"

    x: Place = Field(default=0.0, title="first hole, X mm")
    y: Place = Field(default=0.0, title="first hole, Y mm")
    columns: int = Field(default=3, ge=1, le=1000, title="holes in X")
    rows: int = Field(default=2, ge=1, le=1000, title="holes in Y")
    pitch_x: Length = Field(default=20.0, title="distance in X, mm")
    pitch_y: Length = Field(default=20.0, title="distance in Y, mm")

    def places(self) -> list[tuple[float, float]]:
        """Return the centres, there and back, so that the way is short."""
        if self.columns * self.rows > MOST_LINES:
            raise _too_long()
        made = []
        for row in range(self.rows):
            order = range(self.columns) if row % 2 == 0 else reversed(range(self.columns))
            made += [(self.x + k * self.pitch_x, self.y + row * self.pitch_y) for k in order]
        return made


class HoleCircle(Holes):
    """Holes on a circle."""

    kind = "hole-circle"
    title = "Holes on a circle"

    x: Place = Field(default=0.0, title="centre of the circle, X mm")
    y: Place = Field(default=0.0, title="centre of the circle, Y mm")
    pitch_circle: Length = Field(default=40.0, title="diameter of the circle, mm")
    holes: int = Field(default=6, ge=1, le=1000, title="holes")
    first: FiniteFloat = Field(
        default=0.0, ge=-360.0, le=360.0, title="angle of the first, degrees from X"
    )

    def places(self) -> list[tuple[float, float]]:
        """Return the centres, counter-clockwise."""
        turns = [math.radians(self.first + 360.0 * k / self.holes) for k in range(self.holes)]
        radius = self.pitch_circle / 2.0
        return [(self.x + radius * math.cos(a), self.y + radius * math.sin(a)) for a in turns]


class Text(SimpleJob):
    """A text of single strokes."""

    kind = "text"
    title = "Text"
    tool_kind = "engraver, flat tip"

    text: str = Field(default="cncrun", min_length=1, max_length=200, title="text")
    x: Place = Field(default=0.0, title="start of the base line, X mm")
    y: Place = Field(default=0.0, title="start of the base line, Y mm")
    height: Length = Field(default=10.0, title="height of a capital letter, mm")
    angle: FiniteFloat = Field(
        default=0.0, ge=-360.0, le=360.0, title="angle of the base line, degrees"
    )
    diameter: Length = Field(default=0.5, title="width of the line (tip of the tool), mm")
    depth: Length = Field(default=0.2, title="depth, mm")

    def cuts(self) -> Iterator[str]:
        """Yield each stroke."""
        if missing := sorted(set(self.text) - set(letters())):
            names = " ".join(f"{name!r}" for name in missing)
            raise _wrong(f"the letters have no {names}", "use Latin letters, digits and signs")
        cosine, sine = math.cos(math.radians(self.angle)), math.sin(math.radians(self.angle))
        for stroke in strokes(self.text, self.height)[0]:
            places = [
                (self.x + x * cosine - y * sine, self.y + x * sine + y * cosine) for x, y in stroke
            ]
            yield f"G0 Z{_n(self.clear)}"
            yield f"G0 {_xy(places[0])}"
            yield f"G1 Z{_n(-self.depth)} F{_n(self.plunge)}"
            for k, (x, y) in enumerate(places[1:]):
                yield f"G1 {_xy((x, y))}" + ("" if k else f" F{_n(self.feed)}")


KINDS: dict[str, type[SimpleJob]] = {
    job.kind: job
    for job in (Surfacing, RectangularPocket, RoundPocket, Slot, HoleGrid, HoleCircle, Text)
}


def written(kind: str, parameters: Mapping[str, Any], dialect: DialectName = "linuxcnc") -> str:
    """Return the program of a simple job.

    Args:
        kind: One of ``KINDS``.
        parameters: Those that differ from the defaults, by name.
        dialect: Of the control that reads it. Some lack a code of the first line, or have another
            word or unit for the time of G4.

    Raises:
        UsageError: ``job-kind``, ``job-parameter``.
    """
    if kind not in KINDS:
        message = f"there is no simple job {kind[:80]!r}"
        raise UsageError(Diagnostic("job-kind", message, hint=f"there are {', '.join(KINDS)}"))
    try:
        job = KINDS[kind].model_validate(dict(parameters))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = ".".join(map(str, first["loc"]))
        raise _wrong(f"{name[:80]}: {first['msg']}", "correct this value") from None
    lines: list[str] = []
    for line in job.lines(load(dialect)):
        if len(lines) >= MOST_LINES:
            raise _too_long()
        lines.append(line)
    return "\n".join([*lines, ""])


def described() -> list[dict[str, Any]]:
    """Return the jobs: ``kind``, ``title``, and ``parameters``, for a form.

    A parameter has ``name``, ``title``, ``default`` and ``type`` (``number``, ``integer`` or
    ``text``). Those of the job come first, then the passes, then the tool.
    """
    return [
        {
            "kind": job.kind,
            "title": job.title,
            "parameters": [
                {
                    "name": name,
                    "title": field.title,
                    "default": field.default,
                    "type": _type_of(field.annotation),
                }
                for name, field in sorted(job.model_fields.items(), key=lambda item: _rank(item[0]))
            ],
        }
        for job in KINDS.values()
    ]


def _rank(name: str) -> int:
    """Return the place of a parameter in a form."""
    if name == "depth":
        return 1
    if name in SimpleJob.model_fields:
        return 3
    return 2 if name in Milled.model_fields or name in Holes.model_fields else 0


def _type_of(annotation: object) -> Literal["number", "integer", "text"]:
    return "text" if annotation is str else "integer" if annotation is int else "number"


def _helix(
    job: Milled,
    centre: tuple[float, float],
    radius: float,
    depths: tuple[float, float],
) -> Iterator[str]:
    """Yield a helix from one depth to the next, and a circle on its floor; it ends at +X."""
    x, y = centre
    here = _xy((x + radius, y))
    if depths[0] == 0.0:
        yield f"G0 {here}"
        yield f"G1 Z{_n(depths[0])} F{_n(job.plunge)}"
    else:
        yield f"G1 {here} F{_n(job.feed)}"
    turns = _count(depths[0] - depths[1], 2.0 * math.pi * radius * RAMP)
    for k in range(turns):
        z = depths[0] + (depths[1] - depths[0]) * (k + 1) / turns
        yield f"G3 {here} Z{_n(z)} I{_n(-radius)} J0 F{_n(job.plunge)}"
    yield f"G3 {here} I{_n(-radius)} J0 F{_n(job.feed)}"


def _ramp(
    job: Milled,
    begin: tuple[float, float],
    end: tuple[float, float],
    depths: tuple[float, float],
) -> Iterator[str]:
    """Yield a ramp from one depth to the next, there and back on a line; it ends at ``begin``."""
    way = math.dist(begin, end)
    if way < job.diameter / 2.0:
        raise _wrong("the pocket is too short and narrow for a ramp", "take a thinner tool")
    if depths[0] == 0.0:
        yield f"G0 {_xy(begin)}"
        yield f"G1 Z{_n(depths[0])} F{_n(job.plunge)}"
    passes = 2 * _count(depths[0] - depths[1], 2.0 * way * RAMP)
    for k in range(passes):
        x, y = begin if k % 2 else end
        z = depths[0] + (depths[1] - depths[0]) * (k + 1) / passes
        yield f"G1 {_xy((x, y))} Z{_n(z)} F{_n(job.plunge)}"


def _count(length: float, step: float) -> int:
    """Return the least number of equal parts of a length that are no longer than a step."""
    return max(math.ceil(length / step - 1e-9), 1)


def _n(value: float) -> str:
    """Return a number with at most four decimals."""
    return decimal_text(value, 4)


def _xy(place: tuple[float, float]) -> str:
    """Return the words of a place."""
    return f"X{_n(place[0])} Y{_n(place[1])}"


def _wrong(message: str, hint: str) -> UsageError:
    return UsageError(Diagnostic("job-parameter", message, hint=hint))


def _too_long() -> UsageError:
    message = f"the program has more than {MOST_LINES} lines"
    return _wrong(message, "take wider or deeper passes, or fewer holes")

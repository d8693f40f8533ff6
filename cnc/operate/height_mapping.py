"""Probing of a surface on a grid: the program that probes, and the height map of its contacts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from cnc.machine.height_map import LEAST_TOLERANCE, MOST_POINTS, TOLERANCE, HeightMap
from cnc.model.choices import Interpolation
from cnc.model.diagnostics import EXIT_BOARD, BoardError, CncError, Diagnostic, UsageError
from cnc.operate.events import JobEnded

HEIGHT_MAP = "height map"
"""Name of the activity in the events."""
FIRST_PARAMETER = 31
MOST_CONTACTS = 4900
"""Contacts of one grid: each has a numbered parameter, #31 to #4930."""
SAME_ZERO = 0.001
"""Largest distance of two work zeros that count as one, mm."""
MISSED = FIRST_PARAMETER - 1
"""Parameter with the number of points without a contact in a row."""
NOTHING = 1e6
"""Added to the height of a point without a contact, mm."""
FARTHEST = 10.0
"""Largest distance of the surface from the work zero, mm. Beyond it, Z was not set here."""

Span = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """A grid to probe, in work coordinates.

    Attributes:
        x: Lowest and highest X, mm.
        y: Lowest and highest Y, mm.
        step: Largest distance of two points, mm.
        clear: Z of the moves between the points, mm.
        depth: Lowest Z of the contact, mm below the work zero.
        feed: Speed of the contact, mm/min.
        zero: Whether the first contact becomes Z zero of the coordinate system.
        interpolation: Heights between the points.
        tolerance: Largest distance of the pieces of a move from the warped move, mm.
    """

    x: Span
    y: Span
    step: float = 10.0
    clear: float = 2.0
    depth: float = 2.0
    feed: float = 60.0
    zero: bool = False
    interpolation: Interpolation = "bilinear"
    tolerance: float = TOLERANCE

    def check(self) -> None:
        """Raise UsageError ``height-map-grid`` for a grid that cannot be probed."""
        values = (*self.x, *self.y, self.step, self.clear, self.depth, self.feed)
        wrong = ""
        if not all(map(math.isfinite, values)):
            wrong = "a value is not a number"
        elif self.x[1] - self.x[0] <= 0.0 or self.y[1] - self.y[0] <= 0.0:
            wrong = "the area is empty: give the lowest value of each axis first"
        elif min(self.step, self.clear, self.depth, self.feed) <= 0.0:
            wrong = "step, clear, depth and feed must be greater than 0"
        elif not LEAST_TOLERANCE <= self.tolerance <= 1.0:
            wrong = f"the tolerance must be {LEAST_TOLERANCE:g} to 1 mm"
        elif max(self._counts()) > MOST_POINTS or math.prod(self._counts()) > MOST_CONTACTS:
            columns, rows = self._counts()
            wrong = f"{columns} x {rows} points are more than {MOST_CONTACTS}"
        if wrong:
            hint = "such as X0:100 Y0:60 --step 10 --clear 2 --depth 2 --feed 60"
            raise UsageError(Diagnostic("height-map-grid", wrong, hint=hint))

    def _counts(self) -> tuple[int, int]:
        """Return the number of columns and rows."""
        spans = (self.x[1] - self.x[0], self.y[1] - self.y[0])
        columns, rows = (math.ceil(span / self.step - 1e-9) + 1 for span in spans)
        return max(columns, 2), max(rows, 2)

    def columns(self) -> list[float]:
        """Return X of the columns, mm."""
        return _spread(self.x, self._counts()[0])

    def rows(self) -> list[float]:
        """Return Y of the rows, mm."""
        return _spread(self.y, self._counts()[1])

    def program(self, height: float) -> str:
        """Return the program that probes the grid.

        Args:
            height: Present work position of Z, mm.
        """
        xs, ys = self.columns(), self.rows()
        lines = ["G21 G90 G94 G40 G49 G17"]
        first = f"G0 X{xs[0]:.6f} Y{ys[0]:.6f}"
        if self.zero:
            reach = self.clear + self.depth
            lines += [
                first,
                f"G91 G38.2 Z{-reach:.6f} F{self.feed:g}",
                "G90 G10 L20 P#5220 Z[#5422 - #5063]",
            ]
        elif height > self.clear:
            lines.append(first)
        places = []
        for row, y in enumerate(ys):
            # There and back, so that the way is short.
            order = range(len(xs)) if row % 2 == 0 else reversed(range(len(xs)))
            for column in order:
                number = FIRST_PARAMETER + row * len(xs) + column
                places.append((number, f"G0 X{xs[column]:.6f} Y{y:.6f}"))
        return "\n".join([*lines, *_contacts(places, self.clear, self.depth, self.feed), "M2", ""])

    def height_map(
        self, parameters: Mapping[int, float], system: str, work_zero: Mapping[str, float]
    ) -> HeightMap:
        """Return the map of the contacts.

        Args:
            parameters: Those after the program.
            system: Coordinate system of the program.
            work_zero: Machine position of the work zero by axis, mm.

        Raises:
            UsageError: ``height-map-grid`` if the surface is far from the work zero.
        """
        xs, ys = self.columns(), self.rows()
        heights = tuple(
            tuple(_height(parameters[FIRST_PARAMETER + row * len(xs) + k]) for k in range(len(xs)))
            for row in range(len(ys))
        )
        surface = HeightMap(
            x=tuple(round(place + work_zero["x"], 6) for place in xs),
            y=tuple(round(place + work_zero["y"], 6) for place in ys),
            heights=heights,
            interpolation=self.interpolation,
            tolerance=self.tolerance,
            system=system,
            work_zero={letter: round(value, 6) for letter, value in work_zero.items()},
            probed=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        low, high = surface.extremes
        if max(abs(low), abs(high)) > FARTHEST:
            message = f"the surface is at Z{low:.3f} to {high:.3f} of {system}, far from its zero"
            hint = "set Z zero on the surface first, or let the first contact set it (zero)"
            raise UsageError(Diagnostic("height-map-grid", message, hint=hint))
        return surface


@dataclass(frozen=True, slots=True, kw_only=True)
class PointsAgain:
    """Points of a height map to probe again.

    Attributes:
        surface: The map.
        points: (column, row) of each, from 0.
        clear: Z of the moves between the points, mm.
        depth: Lowest Z of a contact, mm below the work zero.
        feed: Speed of the contact, mm/min.
    """

    surface: HeightMap
    points: tuple[tuple[int, int], ...]
    clear: float = 2.0
    depth: float = 2.0
    feed: float = 60.0

    def check(self, system: str, work_zero: Mapping[str, float]) -> None:
        """Refuse what would give heights of another surface. UsageError ``height-map-grid``.

        Args:
            system: Coordinate system in use.
            work_zero: Machine position of its zero by axis, mm.
        """
        surface, wrong = self.surface, ""
        columns, rows = len(surface.x), len(surface.y)
        hint = "probe the whole grid again"
        if not 0 < len(self.points) <= MOST_CONTACTS:
            wrong = "no point is chosen"
        elif any(not (0 <= c < columns and 0 <= r < rows) for c, r in self.points):
            wrong = f"a point is outside of the {columns} x {rows} points of the map"
        elif not all(map(math.isfinite, (self.clear, self.depth, self.feed))):
            wrong = "a value is not a number"
        elif min(self.depth, self.feed) <= 0.0 or self.clear <= surface.extremes[1]:
            wrong, hint = "clear must be above the surface, depth and feed above 0", "raise clear"
        elif system != surface.system:
            wrong, hint = f"the map is of {surface.system}, and {system} is in use", "choose it"
        elif any(
            abs(work_zero[axis] - surface.work_zero.get(axis, math.inf)) > SAME_ZERO
            for axis in ("x", "y", "z")
        ):
            wrong = f"the zero of {system} is not the one of the map any more"
        if wrong:
            raise UsageError(Diagnostic("height-map-grid", wrong, hint=hint))

    def program(self, height: float) -> str:
        """Return the program that probes the points.

        Args:
            height: Present work position of Z, mm.
        """
        zero, surface = self.surface.work_zero, self.surface
        places = [
            (number, f"G0 X{surface.x[c] - zero['x']:.6f} Y{surface.y[r] - zero['y']:.6f}")
            for number, (c, r) in enumerate(self.points, FIRST_PARAMETER)
        ]
        lines = ["G21 G90 G94 G40 G49 G17", *([places[0][1]] if height > self.clear else [])]
        return "\n".join([*lines, *_contacts(places, self.clear, self.depth, self.feed), "M2", ""])

    def height_map(self, parameters: Mapping[int, float]) -> HeightMap:
        """Return the map with the new contacts; ``parameters`` are those after the program.

        A point without a contact is a gap, whatever it was before.
        """
        heights = [list(row) for row in self.surface.heights]
        for k, (column, row) in enumerate(self.points):
            heights[row][column] = _height(parameters[FIRST_PARAMETER + k])
        return self.surface.model_copy(update={"heights": tuple(map(tuple, heights))})


def not_probed(ended: JobEnded, name: str) -> CncError:
    """Return the fault of a program of contacts that has not reached its end.

    Args:
        ended: Its end.
        name: Of the activity: that of a height map, or of a measurement.
    """
    errors = [finding for finding in ended.findings if finding.severity == "error"]
    reason = errors[0].message if errors else "it was stopped"
    what, again, code = "the surface is not probed", "probe the whole grid again", "height-map-grid"
    if name != HEIGHT_MAP:
        what, again, code = "the face is not touched", "measure again", "measure-contact"
    fault = BoardError if ended.exit_code == EXIT_BOARD else UsageError
    hint = f"correct the cause, and {again}"
    return fault(Diagnostic(code, f"{what}: {reason}", hint=hint))


def _contacts(
    places: Iterable[tuple[int, str]], clear: float, depth: float, feed: float
) -> list[str]:
    """Return the lines that probe points one after another.

    Where the probe met nothing, G38.3 goes on to the next point. G38.2 stops: at the first point,
    and at the third one in a row. The cable may be off, or the part not there.

    Args:
        places: Parameter of the height and move above the point, of each.
        clear: See :class:`Grid`.
        depth: See :class:`Grid`.
        feed: See :class:`Grid`.
    """
    up = f"G0 Z{clear:.6f}"
    lines = [up, f"#{MISSED} = 2"]
    for number, place in places:
        lines += [
            place,
            f"G[38.3 - 0.1 * [#{MISSED} GE 2]] Z{-depth:.6f} F{feed:g}",
            f"#{MISSED} = [[#{MISSED} + 1] * [1 - #5070]]",
            f"#{number} = [#5063 + {NOTHING:.0f} * [1 - #5070]]",
            up,
        ]
    return lines


def _height(number: float) -> float | None:
    """Return the height of a point; None for one without a contact."""
    return None if number > 0.5 * NOTHING else round(number, 6)


def _spread(span: Span, count: int) -> list[float]:
    low, high = span
    return [low + (high - low) * k / (count - 1) for k in range(count)]

r"""Errors of a machine with a motor for each axis: its volume, leaning axes, screws with errors.

    tip (true place) ──► place it is sent to ──► places along the axes ──► places of the motors
                    error map             squareness                error table

Squareness. X is the reference, and Y stays in the plane of X and Y. With a, b, c, the angles of XY,
XZ, YZ beyond 90 degrees, the unit vectors along the axes are the columns of E:

    E = | 1  -sin a  -sin b |      tip = E places        Y |  \      XY above 90 degrees:
        | 0   cos a     p   |                              |   \     Y leads the tip towards -X
        | 0     0       q   |      places = E^-1 tip       └──────► X

p = -(sin c + sin a sin b) / cos a makes the product of Y and Z -sin c; q makes the length of Z 1.

Error table. A screw stands at x + e(x) where its motor is sent to x. So the motor goes to x_k where
the axis shall be at x_k + e_k. Between these points the correction, motor less place, is the
natural cubic spline (de Boor, A Practical Guide to Splines, chapter IV). It is linear beyond them.
Its second derivative has no jump, so the acceleration of the motor has none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kinematics.interval import Interval
from cnc.kinematics.series import Series
from cnc.kinematics.splines import natural_spline
from cnc.kinematics.volume import CellsOfVolume, Volume

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEEPEST = 0.5
"""Largest slope of a correction. No screw is so wrong: the table has other units, or no errors."""
SLACK = 1e-6
"""Distance beyond the knots of a cell at which its polynomial still stands for the spline, mm."""
CLOSE = 1e-12
"""Accuracy of the inverse of a correction, mm."""


def leaning_axes(xy: float = 0.0, xz: float = 0.0, yz: float = 0.0) -> Floats:
    """Return the unit vectors along the axes as columns (3, 3), from the angles beyond 90, rad."""
    along_y = -(math.sin(yz) + math.sin(xy) * math.sin(xz)) / math.cos(xy)
    upright = math.sqrt(1.0 - math.sin(xz) ** 2 - along_y**2)
    return np.array(
        [
            [1.0, -math.sin(xy), -math.sin(xz)],
            [0.0, math.cos(xy), along_y],
            [0.0, 0.0, upright],
        ]
    )


class Cells(NamedTuple):
    """Cells of a correction in which parts of a path lie.

    Attributes:
        number: Number of the cell of each part (m,).
        ends_inside: Whether both ends of each part lie in it (m,).
    """

    number: Ints
    ends_inside: NDArray[np.bool_]


class Screw:
    """The correction of an axis: place of the motor less that of the axis.

    It is the same for both sides of the nut, plus or minus half the play.

    Args:
        places: Places of the axis (n,), ascending, mm; two at least, or none.
        corrections: Mean corrections of both sides there (n,), mm.
        plays: Plays of the nut there (n,), mm; one number where there are no places.

    Attributes:
        knots: The places.
        play: Largest play, mm.
    """

    def __init__(
        self, places: Sequence[float], corrections: Sequence[float], plays: Sequence[float]
    ) -> None:
        self.knots: Floats = np.array(places, np.float64)
        self.play = max(plays)
        halves = 0.5 * np.array(plays, np.float64)
        if not len(self.knots):
            self._cubics = np.zeros((1, 4))
            self._halves = np.array([[halves[0], 0.0, 0.0, 0.0]])
            self._origins = np.zeros(1)
            return
        self._cubics = natural_spline(self.knots, np.array(corrections, np.float64))
        self._halves = natural_spline(self.knots, halves)
        # Each cell begins at the knot before it; the first one at its own end.
        self._origins = np.concatenate((self.knots[:1], self.knots))

    def cells(self, places: Floats) -> Ints:
        """Return the cell of each place; cell 0 is in front of the first knot."""
        return np.searchsorted(self.knots, places, "right").astype(np.int64)

    def correction(self, places: Floats, side: Floats | float = 0.0) -> Floats:
        """Return the corrections at places of the axis, mm.

        Args:
            places: Places (n,), mm.
            side: Side of the nut, -1 to 1 (n,); 0 for the mean of both.
        """
        cells = self.cells(places)
        a, b, c, d = self._cubics[cells].T + side * self._halves[cells].T
        h = places - self._origins[cells]
        values: Floats = a + h * (b + h * (c + h * d))
        return values

    def parts_in_cells(self, start: Floats, middle: Floats, end: Floats) -> Cells:
        """Return the cells of parts of a path from three places (m,) of each."""
        number = self.cells(middle)
        low, high = self._range(number)
        inside = (np.minimum(start, end) >= low) & (np.maximum(start, end) <= high)
        return Cells(number, inside)

    def _range(self, number: Ints) -> tuple[Floats, Floats]:
        """Return the lowest and the highest place for which a cell stands."""
        low = np.concatenate(([-np.inf], self.knots))[number] - SLACK
        return low, np.concatenate((self.knots, [np.inf]))[number] + SLACK

    def motor(
        self, place: Series, cells: Cells, side: Series | Floats | float, shift: float
    ) -> Series:
        """Return the series of the motor from that of the axis.

        Args:
            place: The axis on parts of a path (m,).
            cells: The cell of each part. A part that leaves its cell has no bounds.
            side: The side of the nut, -1 to 1.
            shift: Distance of ``place`` from the place of the cells, mm: the error map moves it by
                so little that the polynomial still stands for the spline.
        """
        a, b, c, d = self._cubics[cells.number].T
        h = place - self._origins[cells.number]
        motor: Series = place + (h * (h * (h * d + c) + b) + a)
        if self.play:
            a, b, c, d = self._halves[cells.number].T
            even = not (b.any() or c.any() or d.any())
            motor = motor + (side * a if even else (h * (h * (h * d + c) + b) + a) * side)
        first = place.terms[0]
        if not isinstance(first, Interval):
            return motor
        low, high = self._range(cells.number)
        leaves = (first.lo < low - shift) | (first.hi > high + shift)
        # A place that only rises or only falls lies between its ends.
        rate = place.terms[1]
        turns = (rate.lo < 0.0) & (rate.hi > 0.0) if isinstance(rate, Interval) else False
        beyond = np.where(leaves & (turns | ~cells.ends_inside), np.inf, 0.0)
        return Series([*motor.terms[:-1], Interval(-beyond, beyond) + motor.terms[-1]])

    def place(self, motors: Floats, side: Floats | float) -> Floats:
        """Return the places of the axis at places of its motor, mm."""
        places = motors - self.correction(motors, side)
        # The slope of the correction is at most STEEPEST: each pass halves the error at least.
        for _ in range(64):
            before, places = places, motors - self.correction(places, side)
            if not np.any(np.abs(places - before) > CLOSE):
                break
        return places

    def steepest(self) -> tuple[float, int]:
        """Return the largest slope of the correction, without sign, and the number of its cell."""
        _, b, c, d = self._cubics.T
        width = np.concatenate(([0.0], np.diff(self.knots), [0.0]))
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = np.clip(np.nan_to_num(-c / (3.0 * d)), 0.0, width)
        slopes = np.abs([b + h * (2.0 * c + 3.0 * h * d) for h in (0.0 * width, middle, width)])
        cell = int(np.argmax(slopes.max(axis=0)))
        return float(slopes[:, cell].max()), cell


class CellsOfAll(NamedTuple):
    """Cells of all corrections in which parts of a path lie.

    Attributes:
        screws: By the column of their axis.
        volume: Those of the error map, if there is one.
    """

    screws: Mapping[int, Cells]
    volume: CellsOfVolume | None


Sides = Mapping[int, Series | Floats | float]
"""Sides of nuts by the column of their axis: 1 where the motor pushes up, -1 where down."""


class Compensation:
    """Places of the motors at which the tip is where it shall be.

    Args:
        leaning: Unit vectors along the axes as columns (axes, axes), in true directions.
        screws: Corrections by the column of their axis.
        volume: The error map, and the columns of X, Y, Z; None without one.

    Attributes:
        screws: The same.
        square: Matrix (axes, axes) from the place that the tip is sent to, to places along the
            axes.
        is_linear: Whether the motors are a linear function of the tip.
        is_even: Whether corrections do not depend on the place.
    """

    def __init__(
        self,
        leaning: Floats,
        screws: Mapping[int, Screw],
        volume: tuple[Volume, Sequence[int]] | None = None,
    ) -> None:
        self.screws = dict(screws)
        self.square = np.linalg.inv(leaning)
        self._leaning = leaning
        self._volume: Volume | None = None
        self._columns: list[int] = []
        if volume is not None:
            self._volume, self._columns = volume[0], list(volume[1])
        self._shift = 0.0 if self._volume is None else 2.0 * self._volume.largest
        self.is_even = volume is None and not any(len(s.knots) for s in self.screws.values())
        self.is_linear = self.is_even and not any(screw.play for screw in self.screws.values())

    def cells(self, start: Floats, middle: Floats, end: Floats) -> CellsOfAll:
        """Return the cells of parts of a path from three tips (m, axes) of each."""
        three = [tips @ self.square.T for tips in (start, middle, end)]
        screws = {
            axis: screw.parts_in_cells(*(places[:, axis] for places in three))
            for axis, screw in self.screws.items()
        }
        return CellsOfAll(screws, self.cells_of_volume(start, middle, end))

    @property
    def has_volume(self) -> bool:
        """Whether there is an error map."""
        return self._volume is not None

    def cells_of_volume(self, start: Floats, middle: Floats, end: Floats) -> CellsOfVolume | None:
        """Return the cells of the error map, as :meth:`cells`; None without a map."""
        if self._volume is None:
            return None
        return self._volume.cells(*(tips[:, self._columns] for tips in (start, middle, end)))

    def place(self, axis: int, tip: Sequence[Series], cells: CellsOfVolume | None) -> Series:
        """Return the series of the place along an axis from those of the tip."""
        return _weighted(self.square[axis].tolist(), self._sent(tip, cells))

    def _sent(self, tip: Sequence[Series], cells: CellsOfVolume | None) -> list[Series]:
        """Return the series of the place that the tip is sent to."""
        sent = list(tip)
        if self._volume is not None and cells is not None:
            three = [tip[column] for column in self._columns]
            corrections = self._volume.series(three, cells)
            for column, correction in zip(self._columns, corrections, strict=True):
                sent[column] = sent[column] - correction
        return sent

    def motors(self, tip: Sequence[Series], cells: CellsOfAll, sides: Sides) -> list[Series]:
        """Return the series of the motors from those of the tip on parts of a path in cells."""
        sent = self._sent(tip, cells.volume)
        motors = [_weighted(row, sent) for row in self.square.tolist()]
        for axis, screw in self.screws.items():
            side = sides.get(axis, 1.0)
            motors[axis] = screw.motor(motors[axis], cells.screws[axis], side, self._shift)
        return motors

    def motors_at(self, tips: Floats, sides: Sides | None = None) -> Floats:
        """Return the motors (m, axes) at tips (m, axes), mm; without sides, pushed up."""
        cells = self.cells(tips, tips, tips)
        motors = self.motors([Series([column]) for column in tips.T], cells, sides or {})
        return np.stack([np.asarray(motor.terms[0]) for motor in motors], axis=-1)

    def tips_at(self, motors: Floats, sides: Sides | None = None) -> Floats:
        """Return the tips (m, axes) at motors (m, axes), mm; without sides, pushed up."""
        places = motors.copy()
        for axis, screw in self.screws.items():
            side = (sides or {}).get(axis, 1.0)
            side = side.terms[0] if isinstance(side, Series) else side
            places[:, axis] = screw.place(motors[:, axis], side)
        tips: Floats = places @ self._leaning.T
        if self._volume is not None:
            tips[:, self._columns] = self._volume.reached(tips[:, self._columns])
        return tips

    def border(self, start: Floats, end: Floats) -> tuple[Floats, Floats]:
        """Return the knots that parts of a path cross; the middle one of several.

        Args:
            start: Tips at the start of the parts (m, axes).
            end: Tips at their end.

        Returns:
            Weights (m, axes) and places (m,): the weighted sum of the tip is the place of a knot.
            Places are not numbers where there is no knot between start and end.
        """
        weights, places = np.zeros_like(start), np.full(len(start), np.nan)
        for row, knots in self._knots():
            first, last = start @ row, end @ row
            low = np.searchsorted(knots, np.minimum(first, last) + SLACK, "right")
            high = np.searchsorted(knots, np.maximum(first, last) - SLACK, "right")
            crossed = np.flatnonzero((high > low) & np.isnan(places))
            weights[crossed] = row
            places[crossed] = knots[(low + high)[crossed] // 2]
        return weights, places

    def _knots(self) -> Iterator[tuple[Floats, Floats]]:
        """Yield rows (axes,) and knots: cells end where the weighted sum of the tip is a knot."""
        for axis, screw in self.screws.items():
            yield self.square[axis], screw.knots
        if self._volume is not None:
            for column, places in zip(self._columns, self._volume.grid, strict=True):
                yield np.eye(len(self.square))[column], places


def _weighted(row: list[float], tip: Sequence[Series]) -> Series:
    """Return the weighted sum of the axes."""
    shares = [axis if w == 1.0 else axis * w for w, axis in zip(row, tip, strict=True) if w]
    place = shares[0]
    for share in shares[1:]:
        place = place + share
    return place

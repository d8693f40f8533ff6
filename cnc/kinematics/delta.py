r"""Three towers with carriages, or three turning arms, that hold the tip by rods (delta robots).

Linear delta. Carriage i slides on a vertical tower at (X_i, Y_i) and holds the tip by a rod of
length L:

       |  o carriage q      q_i = z + sqrt(L^2 - (x - X_i)^2 - (y - Y_i)^2)
       |   \
       |    \ L             The carriages are above the tip. The tip is where three spheres of
       |     \              radius L about the carriages meet, below them.
     tower    o tip z

Rotary delta. Upper arm i of length l turns about a horizontal axis at the distance R from the
centre, in the vertical plane of the angle phi_i. A rod of length L leads from its end to the
platform, of radius P. In the plane of the arm, with the tip's coordinates rho along phi_i and t
across, and e = rho + P - R:

     R    elbow              the elbow is at (R + l cos q, -l sin q), so
    --o---.                  (e - l cos q)^2 + t^2 + (z + l sin q)^2 = L^2
       l ,'\  L              e cos q - z sin q = k,   k = (e^2 + z^2 + t^2 + l^2 - L^2) / (2 l)
             \               q = atan2(-z, e) - acos-branch:  with w = sqrt(e^2 + z^2 - k^2)
         P  --o  z           q = atan2(-z, e) - atan2(w, k)

q is 0 where the arm is level, and positive where it points down. The elbow points outwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field, field_validator
from pydantic import ValidationInfo as Info

from cnc.kinematics.base import DEGREES, Angles, Floats, Length, TableWithFormulas
from cnc.kinematics.series import Series, atan2, sqrt


class Delta(TableWithFormulas):
    """Three carriages on vertical towers hold the tip by rods."""

    moved = ("x", "y", "z")
    movers = ("a", "b", "c")
    turning = (False, False, False)

    type: Literal["delta"] = Field(description="Joints a, b and c: heights of the carriages, mm.")
    radius: Length = Field(
        description=(
            "Distance of the towers from the centre, less that of the rods' ends from the tip, mm."
        )
    )
    rod: Length = Field(description="Length of the rods, mm.")
    angles: Angles = Field(
        default=(210.0, 330.0, 90.0), description="Angles of the towers, degrees from X."
    )

    @field_validator("rod")
    @classmethod
    def _reaches_the_centre(cls, rod: float, info: Info) -> float:
        """Refuse rods that reach no tip at all: the centre is nearest to all towers."""
        if rod <= info.data.get("radius", 0.0):
            raise ValueError("must be longer than radius: the rods do not reach the centre")
        return rod

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the heights of the carriages, mm."""
        x, y, z = tip
        return [
            z + sqrt(self.rod**2 - (x - tower_x).square() - (y - tower_y).square())
            for tower_x, tower_y in self._towers()
        ]

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip."""
        centres = [
            np.stack(np.broadcast_arrays(tower_x, tower_y, height), axis=-1)
            for (tower_x, tower_y), height in zip(self._towers(), joints, strict=True)
        ]
        return _lower_meeting(centres, self.rod)

    def _towers(self) -> list[tuple[float, float]]:
        """Return the places of the towers, mm."""
        angles = [angle / DEGREES for angle in self.angles]
        return [(self.radius * math.cos(angle), self.radius * math.sin(angle)) for angle in angles]


class RotaryDelta(TableWithFormulas):
    """Three arms that turn hold the tip by rods."""

    moved = ("x", "y", "z")
    movers = ("a", "b", "c")
    turning = (True, True, True)

    type: Literal["rotary-delta"] = Field(
        description="Joints a, b and c: angles of the arms below the level, degrees."
    )
    base: Length = Field(description="Distance of the arms' axes from the centre, mm.")
    platform: Length = Field(description="Distance of the rods' ends from the tip, mm.")
    arm: Length = Field(description="Length of the upper arms, mm.")
    rod: Length = Field(description="Length of the rods, mm.")
    angles: Angles = Field(
        default=(210.0, 330.0, 90.0), description="Angles of the arms, degrees from X."
    )

    @field_validator("rod")
    @classmethod
    def _reaches_the_centre(cls, rod: float, info: Info) -> float:
        """Refuse rods that no position of the arms brings to the centre."""
        lengths = info.data
        if {"base", "platform", "arm"} <= lengths.keys():
            least = abs(lengths["base"] - lengths["platform"]) - lengths["arm"]
            if rod <= least:
                raise ValueError(f"must be longer than {least:g}: the rods do not reach the centre")
        return rod

    def inverse(self, tip: Sequence[Series]) -> list[Series]:
        """Return the angles of the arms below the level, degrees."""
        x, y, z = tip
        angles = []
        for cosine, sine in self._directions():
            along = x * cosine + y * sine - (self.base - self.platform)
            across = y * cosine - x * sine
            squares = along.square() + z.square()
            k = (squares + across.square() + (self.arm**2 - self.rod**2)) * (0.5 / self.arm)
            root = sqrt(squares - k.square())
            angles.append((atan2(-z, along) - atan2(root, k)) * DEGREES)
        return angles

    def forward(self, joints: Sequence[Floats]) -> list[Floats]:
        """Return the tip."""
        centres = []
        for (cosine, sine), angle in zip(self._directions(), joints, strict=True):
            out = (self.base - self.platform) + self.arm * np.cos(angle / DEGREES)
            down = -self.arm * np.sin(angle / DEGREES)
            centres.append(np.stack((out * cosine, out * sine, down), axis=-1))
        return _lower_meeting(centres, self.rod)

    def _directions(self) -> list[tuple[float, float]]:
        """Return cosine and sine of the arms' angles."""
        return [(math.cos(angle / DEGREES), math.sin(angle / DEGREES)) for angle in self.angles]


def _lower_meeting(centres: Sequence[Floats], radius: float) -> list[Floats]:
    """Return the lower of the two points where three spheres (m, 3) of one radius meet.

    The points that are equally far from the centres lie on a line, upright on their plane, through
    the centre of the circle about them.
    """
    p, q, r = centres
    u, v = q - p, r - p
    normal = np.cross(u, v)
    uu, vv, nn = ((w * w).sum(axis=-1, keepdims=True) for w in (u, v, normal))
    middle = np.cross(uu * v - vv * u, normal) / (2.0 * nn)
    with np.errstate(invalid="ignore"):
        height = np.sqrt((radius**2 - (middle * middle).sum(axis=-1, keepdims=True)) / nn)
    down = np.where(normal[..., 2:] > 0.0, -1.0, 1.0)
    tip = p + middle + down * height * normal
    return [tip[..., k] for k in range(3)]

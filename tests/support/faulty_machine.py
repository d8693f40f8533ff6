"""A machine with errors, written anew: from the steps of its motors to the place of its tool."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass
class FaultyMachine:
    """Errors of a machine with the axes X, Y, Z.

    Attributes:
        xy: Angle between +X and +Y less 90 degrees, in degrees; so are xz and yz.
        screws: By axis, the error at the place to which the motor was sent, mm.
        backlash: By axis, the play of the nut, mm.
        volume: The error (n, 3) at places (n, 3) where the machine would stand with the errors
            above alone, mm.
    """

    xy: float = 0.0
    xz: float = 0.0
    yz: float = 0.0
    screws: Mapping[str, Callable[[Floats], Floats]] = field(default_factory=dict)
    backlash: Mapping[str, float] = field(default_factory=dict)
    volume: Callable[[Floats], Floats] | None = None

    def tool(self, motors: Floats) -> Floats:
        """Return the places of the tool (n, 3) while the motors go through places (n, 3), mm.

        At first each nut lies against the flank that pushes it up.
        """
        nuts = motors.copy()
        for column, letter in enumerate("xyz"):
            if letter in self.backlash:
                play = self.backlash[letter]
                nuts[:, column] = pushed(motors[:, column], play, motors[0, column] - 0.5 * play)
            if letter in self.screws:
                nuts[:, column] += self.screws[letter](nuts[:, column])
        # Unit vectors along the axes from their angles, by the products that these have.
        x = np.array([1.0, 0.0, 0.0])
        a, b, c = (np.cos(np.radians(90.0 + angle)) for angle in (self.xy, self.xz, self.yz))
        y = np.array([a, np.sqrt(1.0 - a * a), 0.0])
        z = np.array([b, (c - a * b) / y[1], 0.0])
        z[2] = np.sqrt(1.0 - z @ z)
        tool: Floats = nuts @ np.stack((x, y, z))
        return tool if self.volume is None else tool + self.volume(tool)


def pushed(motor: Floats, play: float, begin: float) -> Floats:
    """Return the places of a nut between two flanks, ``play`` apart, that the motor moves.

    Before the first place of the motor the nut is at ``begin``.
    """
    nut, half, places = begin, 0.5 * play, []
    for flank in motor.tolist():
        if nut < flank - half:
            nut = flank - half
        elif nut > flank + half:
            nut = flank + half
        places.append(nut)
    return np.array(places)

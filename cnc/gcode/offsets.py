"""Coordinate systems: from program coordinates to machine coordinates, as pure state.

    machine = programmed + origin of the coordinate system in use + G92 shift

The shift belongs to no system: it stays when another one is chosen. Source: LinuxCNC, "Coordinate systems", G10, G54-G59.3, G92.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

Vector = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Offsets:
    """Offsets in mm or degrees, one number an axis.

    ``origins`` of the coordinate systems in machine coordinates, the index of the ``current`` one, the G92 ``shift`` in effect, and the one
    ``kept`` for G92.3.
    """

    origins: tuple[Vector, ...]
    current: int
    shift: Vector
    kept: Vector

    @classmethod
    def none(cls, axes: int, systems: int = 9) -> Offsets:
        """All zero, the first system in use."""
        zero = (0.0,) * axes
        return cls((zero,) * systems, 0, zero, zero)

    @property
    def zero(self) -> Vector:
        """The machine position of the program's zero point."""
        return tuple(origin + shift for origin, shift in zip(self.origins[self.current], self.shift, strict=True))

    def use(self, system: int) -> Offsets:
        """G54 (0) to G59.3 (8)."""
        return replace(self, current=system)

    def set_origin(self, system: int, values: Mapping[int, float], *, add: bool = False) -> Offsets:
        """G10 L2: the origin of a system, by axis index; ``add`` to the present one where the dialect's G91 says so."""
        old = self.origins[system]
        return self._with(system, {axis: old[axis] + value if add else value for axis, value in values.items()})

    def set_origin_here(self, system: int, values: Mapping[int, float], position: list[float]) -> Offsets:
        """G10 L20: the origin of a system such that the machine ``position`` gets the ``values`` there, the shift counted in."""
        return self._with(system, {axis: position[axis] - self.shift[axis] - value for axis, value in values.items()})

    def _with(self, system: int, values: Mapping[int, float]) -> Offsets:
        origin = tuple(values.get(axis, old) for axis, old in enumerate(self.origins[system]))
        return replace(self, origins=(*self.origins[:system], origin, *self.origins[system + 1 :]))

    def shift_here(self, values: Mapping[int, float], position: list[float]) -> Offsets:
        """G92: the shift such that the machine ``position`` gets the ``values``; axes without a value keep the shift in effect."""
        origin = self.origins[self.current]
        shift = tuple(position[axis] - origin[axis] - values[axis] if axis in values else old for axis, old in enumerate(self.shift))
        return replace(self, shift=shift, kept=shift)

    def clear_shift(self) -> Offsets:
        """G92.1: no shift, and none kept."""
        zero = (0.0,) * len(self.shift)
        return replace(self, shift=zero, kept=zero)

    def suspend_shift(self) -> Offsets:
        """G92.2: no shift, but the present one is kept for G92.3."""
        return replace(self, shift=(0.0,) * len(self.shift))

    def restore_shift(self) -> Offsets:
        """G92.3: the shift that was kept."""
        return replace(self, shift=self.kept)

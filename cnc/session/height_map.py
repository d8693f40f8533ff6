"""The height map of a session: its file, the warp of each reading, and its use in the report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cnc.machine.height_map import HeightMap, load_height_map
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS, Block
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.path.surface import Surface
from cnc.path.warp import Warp
from cnc.report.result import WarpedBy

MOVED = 0.003
"""Smallest distance of a work zero that was moved, mm: boards report three decimals."""


class ProgramWarp:
    """Warps each reading of a program to the surface of a height map.

    Args:
        file: The height map.
        machine: The machine.

    Raises:
        UsageError: ``height-map-file``, ``height-map-machine``.
    """

    def __init__(self, file: str, machine: Machine) -> None:
        self._file, self._map = file, load_height_map(Path(file))
        if machine.kind == "lathe" or not {"x", "y", "z"} <= set(machine.axes):
            message = f"a height map needs X, Y and Z of a mill; {machine.name} has others"
            hint = "leave --height-map out, or name another machine"
            raise UsageError(Diagnostic("height-map-machine", message, hint=hint))
        self._surface = Surface(
            np.array(self._map.x),
            np.array(self._map.y),
            np.array(self._map.heights),
            smooth=self._map.interpolation == "bicubic",
        )
        self._warp: Warp | None = None

    def blocks(
        self,
        blocks: Iterable[Block],
        machine: Machine,
        start: NDArray[np.float64],
        ceiling: float | None,
    ) -> Iterator[Block]:
        """Return the warped blocks of a reading.

        Args:
            blocks: The blocks of the program.
            machine: The machine, with the travel of the board.
            start: Position of the machine before the program (axes,), mm.
            ceiling: Highest position of Z that keeps clear of its limit switch, mm; None without.
        """
        travel = machine.axes["z"].travel
        tops = [*([] if travel is None else [travel[1]]), *([] if ceiling is None else [ceiling])]
        self._warp = Warp(
            self._surface,
            machine.axis_names,
            self._map.tolerance,
            blend=machine.path.tolerance,
            top=min(tops, default=math.inf),
        )
        return self._warp.blocks(blocks, start)

    def moved_zero(self, parameters: Mapping[int, float]) -> list[Diagnostic]:
        """Return the warning ``height-map-zero`` if the work zero was moved after the probing.

        Args:
            parameters: Those before the program, by number; one that is missing is 0.
        """
        known = self._map
        if known.system not in numbers.SYSTEMS:
            return []
        origin = numbers.origin(numbers.SYSTEMS.index(known.system))
        is_shifted = parameters.get(numbers.SHIFT_IN_EFFECT) == 1.0
        moved = []
        for column, letter in enumerate(AXIS_LETTERS[:3]):
            zero = parameters.get(origin + column, 0.0)
            if is_shifted:
                zero += parameters.get(numbers.SHIFT + column, 0.0)
            distance = zero - known.work_zero.get(letter, zero)
            if abs(distance) > MOVED:
                moved.append(f"{letter.upper()} by {distance:.3f} mm")
        if not moved:
            return []
        message = f"the zero of {known.system} was moved after the probing: {', '.join(moved)}"
        hint = (
            "the map stays at its place on the table, and its heights count from Z zero; "
            "probe again if the part was moved"
        )
        return [Diagnostic("height-map-zero", message, hint=hint, severity="warning")]

    def used(self) -> WarpedBy:
        """Return the use of the map by the latest reading."""
        known: HeightMap = self._map
        low, high = known.extremes
        return WarpedBy(
            file=self._file,
            columns=len(known.x),
            rows=len(known.y),
            lowest_mm=low,
            highest_mm=high,
            interpolation=known.interpolation,
            tolerance_mm=known.tolerance,
            pieces=0 if self._warp is None else self._warp.pieces,
        )

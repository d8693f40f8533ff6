"""A bench for homing: the stepper simulator with switches that follow the axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cnc.api import Report, home
from cnc.boards.stepper.driver import Stepper
from cnc.machine.models import Axis, Homing, Machine
from tests.support.boards.stepper_simulator import (
    DIRECTION_PINS,
    STEP_PINS,
    Simulator,
    SimulatorPort,
)
from tests.support.session.runs import run_with

SWITCH_PINS = {"x": 9, "y": 10, "z": 12}
STEPS_PER_MM = 100
QUICK = Homing(seek=20.0, latch=6.0, pull_off=0.5)


def axis(travel: tuple[float, float], homing: Homing | None = QUICK, **changes: object) -> Axis:
    known = Axis(
        steps_per_mm=STEPS_PER_MM,
        max_velocity=40.0,
        max_acceleration=400.0,
        max_jerk=15_000.0,
        travel=travel,
        homing=homing,
    )
    return known.model_copy(update=changes)


def small(**changes: object) -> Machine:
    axes = {"x": axis((0.0, 8.0)), "y": axis((-2.0, 6.0)), "z": axis((-5.0, 1.0))}
    return Machine(axes=axes).model_copy(update=changes)  # type: ignore[arg-type]


class Bench:
    """The chip, its axes' places as its pins have led them (steps, 0 where the bench began), and
    the switches that these close.

    switches: by the axis's letter the places, in steps, from which to which its switch is closed;
    pins are set every 0.5 ms.
    """

    def __init__(self, **switches: tuple[float, float]) -> None:
        self.simulator = Simulator()
        self.port = SimulatorPort(self.simulator)
        self.switches = switches
        self.place = [0, 0, 0, 0]
        self.backward = [0, 0, 0, 0]
        self.seen = 0
        self._run = self.simulator.run
        self.simulator.run = self.felt  # type: ignore[method-assign]
        self.set()

    def felt(self, seconds: float, *, or_byte: bool = False) -> None:
        self._run(min(seconds, 5e-4), or_byte=or_byte)
        edges = self.simulator.edges()
        for _, pin, level, _ in edges[self.seen :].tolist():
            if pin in DIRECTION_PINS:
                self.backward[DIRECTION_PINS.index(pin)] = level
            elif pin in STEP_PINS and level:
                column = STEP_PINS.index(pin)
                self.place[column] += 1 - 2 * self.backward[column]
        self.seen = len(edges)
        self.set()

    def set(self) -> None:
        for letter, (low, high) in self.switches.items():
            self.simulator.set_pin(
                SWITCH_PINS[letter], 0 if low <= self.place["xyz".index(letter)] <= high else 1
            )

    def driver(self, machine: Machine) -> Stepper:
        return Stepper(self.port, machine, "the simulator", clock=self.port)

    def home(self, machine: Machine, *axes: str, **more: object) -> dict[str, float | None]:
        board = self.driver(machine)
        try:
            return home(machine, axes, board=board, **more)  # type: ignore[arg-type]
        finally:
            board.close()

    def standing(self, machine: Machine) -> tuple[int | None, ...]:
        """Return the known position for the next program."""
        board = self.driver(machine)
        try:
            return board.known_steps
        finally:
            board.close()


INF = float("inf")
EVERYWHERE = {"x": (-INF, -300), "y": (-INF, -410), "z": (150, INF)}
"""Switches 3, 4.1 and 1.5 mm away, at the low ends of X and Y and the high end of Z."""


def rows(bench: Bench) -> np.ndarray:
    return bench.simulator.moves()[1]


PROGRAM = "G21 G90\nG1 X2 Y0 Z0 F1200\nM2\n"


def ran(bench: Bench, machine: Machine, folder: Path, **more: object) -> Report:
    (folder / "p.ngc").write_text(PROGRAM)
    board = bench.driver(machine)
    try:
        return run_with(folder / "p.ngc", machine, board=board, **more)
    finally:
        board.close()

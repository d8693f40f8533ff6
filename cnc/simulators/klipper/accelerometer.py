"""The accelerometer of the simulated board (ADXL345), at the tool of a machine that rings.

Each mode is a mass on a spring and a damper, whose foot moves with the axis:

    u'' + 2 d w (u' - x') + w^2 (u - x) = 0        u: place of the mass, x: place of the axis

Between two looks at the motors the axis moves at a constant speed, so u - x decays freely there.
A change of the speed is a jump of its speed. This is exact, whatever the time between two samples.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

from cnc.boards.klipper.accelerometer import (
    BLOCK,
    BW_RATE,
    DEVICE,
    DEVID,
    FIFO_CTL,
    MEASURE,
    POWER_CTL,
    RATES,
    READ,
    SAMPLE,
    SCALE,
    STREAM,
    G,
)
from cnc.boards.klipper.layout import LayoutBuilder, section
from cnc.machine.klipper import Pin
from cnc.machine.models import Machine
from cnc.simulators.klipper.devices import Reader, SpiDevice
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator

FIFO = 32
"""Samples of the FIFO."""
MOST = 4095
"""Largest value of a sample."""
OWN_CLOCK = 1.013
"""Rate of the sensor's own clock by that of the board."""


class Mode(NamedTuple):
    """A mode: frequency, Hz; damping as a part of the critical one; share of the acceleration."""

    frequency: float
    damping: float
    share: float


MODES = (Mode(38.0, 0.05, 0.6), Mode(61.0, 0.04, 0.4))
"""Modes of each axis of the board ``klipper-sim``."""


@dataclass(slots=True)
class _Spring:
    """The state of a mode: u - x, mm, and its speed, mm/s."""

    mode: Mode
    way: float = 0.0
    speed: float = 0.0

    def step(self, jump: float, seconds: float) -> float:
        """Change the speed of the foot by ``jump``, pass time; return u'', mm/s^2."""
        w, d, c, s, decay = _free(self.mode, seconds)
        way, speed = self.way, self.speed - jump
        self.way = decay * (way * (c + d * w * s) + speed * s)
        self.speed = decay * (speed * (c - d * w * s) - way * w * w * s)
        return -2.0 * d * w * self.speed - w * w * self.way


@cache
def _free(mode: Mode, seconds: float) -> tuple[float, float, float, float, float]:
    """Return w and d of a mode, and cosine, sine over damped frequency, and decay after a time."""
    w, d = 2.0 * math.pi * mode.frequency, mode.damping
    damped = w * math.sqrt(1.0 - d * d)
    phase = damped * seconds
    return w, d, math.cos(phase), math.sin(phase) / damped, math.exp(-d * w * seconds)


@dataclass(slots=True)
class AccelerometerModel(SpiDevice):
    """The sensor.

    Attributes:
        place: Gives the place of the tool along the axes of the sensor, mm.
        now: Gives the time of the board, s.
        modes: Modes of each axis.
        noise: Standard deviation of a sample, mm/s^2.
        registers: Its registers.
        powered: Whether it answers.
        wrong: Numbers of the samples that the board reads wrongly.
    """

    place: Callable[[], tuple[float, float, float]]
    now: Callable[[], float]
    modes: Mapping[str, Sequence[Mode]]
    noise: float = 20.0
    registers: dict[int, int] = field(default_factory=lambda: {DEVID: DEVICE})
    powered: bool = True
    wrong: frozenset[int] = frozenset()
    _springs: list[list[_Spring]] = field(default_factory=list)
    _dice: random.Random = field(default_factory=lambda: random.Random(7))
    _seen: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _speeds: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    _next: float = math.inf
    _count: int = 0

    def transfer(self, data: bytes) -> bytes:
        """Write a register, or read one."""
        if not self.powered or len(data) != 2:
            return bytes(len(data))
        if data[0] & READ:
            return bytes((0, self.registers.get(data[0] & ~READ, 0)))
        if data[0] != DEVID:
            self.registers[data[0]] = data[1]
        if data[0] == POWER_CTL:
            self._start()
        return bytes(2)

    def _start(self) -> None:
        """Begin to take samples, or end."""
        self._next = self.now() + self.period if self.measures else math.inf
        self._springs = [[_Spring(mode) for mode in self.modes.get(name, ())] for name in "xyz"]
        self._seen, self._speeds = self.place(), [0.0, 0.0, 0.0]

    @property
    def period(self) -> float:
        """Time between two samples, s of the board."""
        rates = {code: rate for rate, code in RATES.items()}
        return 1.0 / (rates.get(self.registers.get(BW_RATE, 0x0A), 100) * OWN_CLOCK)

    @property
    def measures(self) -> bool:
        """Whether it takes samples into its FIFO."""
        registers = self.registers
        return bool(registers.get(POWER_CTL, 0) & MEASURE) and registers.get(FIFO_CTL) == STREAM

    def waiting(self, now: float) -> int:
        """Return the number of samples in the FIFO at a time, s."""
        return (
            0
            if self._next == math.inf
            else max(math.floor((now - self._next) / self.period) + 1, 0)
        )

    def read(self, now: float) -> tuple[bytes, bool]:
        """Return the bytes of the samples until a time, s, and whether the FIFO has overflowed."""
        here = self.place()
        count = self.waiting(now)
        if not count:
            return b"", False
        period, samples = self.period, bytearray()
        speeds = [(b - a) / (count * period) for a, b in zip(self._seen, here, strict=True)]
        for number in range(count):
            units = []
            for k, springs in enumerate(self._springs):
                jump = 0.0 if number else speeds[k] - self._speeds[k]
                value = self._dice.gauss(G if k == 2 else 0.0, self.noise)
                for spring in springs:
                    value += spring.mode.share * spring.step(jump, period)
                units.append(min(max(round(value / SCALE), -MOST), MOST))
            samples += self._packed(*units)
        self._seen, self._speeds = here, speeds
        self._next += count * period
        return bytes(samples), count > FIFO

    def _packed(self, x: int, y: int, z: int) -> bytes:
        """Return the bytes of a sample, as the firmware packs them."""
        self._count += 1
        if self._count in self.wrong:
            return b"\xff" * SAMPLE
        low = (x & 0xFF, y & 0xFF, z & 0xFF)
        high = (x >> 8 & 0x1F, y >> 8 & 0x1F, z >> 8 & 0x1F)
        return bytes((*low, high[0] | (high[2] & 7) << 5, high[1] | (high[2] >> 3) << 5))


class BulkReader(Reader):
    """The firmware's reader of the sensor: blocks of samples, and their number.

    Args:
        board: The board.
        oid: Its object.
        sensor: The sensor.
    """

    def __init__(self, board: KlipperSimulator, oid: int, sensor: AccelerometerModel) -> None:
        self._board, self._oid, self._sensor = board, oid, sensor
        self._data, self._sequence, self._overflows, self._epoch = b"", 0, 0, 0

    def query(self, rest_ticks: int) -> None:
        """Begin to read the FIFO every so many ticks, or end with 0."""
        self._epoch += 1
        if rest_ticks:
            self._data, self._sequence, self._overflows = b"", 0, 0
            self._again(rest_ticks, self._epoch)

    def status(self) -> None:
        """Tell how many samples there were."""
        board = self._board
        fifo = self._sensor.waiting(board.now)
        board.respond(
            "sensor_bulk_status",
            oid=self._oid,
            clock=board.clock % 2**32,
            query_ticks=round(4e-6 * board.firmware.frequency),
            next_sequence=self._sequence & 0xFFFF,
            buffered=len(self._data) + SAMPLE * fifo,
            possible_overflows=self._overflows,
        )

    def _again(self, rest_ticks: int, epoch: int) -> None:
        board = self._board

        def look() -> None:
            if self._epoch != epoch or board.reason:
                return
            board.settle(board.clock)
            data, overflowed = self._sensor.read(board.now)
            self._overflows += overflowed
            self._data += data
            size = SAMPLE * BLOCK
            while len(self._data) >= size:
                part, self._data = self._data[:size], self._data[size:]
                board.respond(
                    "sensor_bulk_data", oid=self._oid, sequence=self._sequence & 0xFFFF, data=part
                )
                self._sequence += 1
            self._again(rest_ticks, epoch)

        board.at(board.clock + rest_ticks, look)


def add_accelerometer(
    simulator: KlipperSimulator, machine: Machine, modes: Mapping[str, Sequence[Mode]] | None = None
) -> AccelerometerModel | None:
    """Put the accelerometer of a machine file at the tool; return it, None without one.

    Args:
        simulator: The board.
        machine: The machine, whose axes are its motors.
        modes: Modes of each axis; None for MODES along X, Y and Z.
    """
    table = section(machine).accelerometer
    if table is None:
        return None
    layout = LayoutBuilder(machine, simulator.firmware.dictionary).build()
    counts: dict[str, tuple[int, float]] = {}
    for motor in layout.motors:
        letter = str(tuple(machine.axes)[motor.column])
        axis = section(machine).axis(letter)
        if motor.number == 0 and axis is not None:
            scale = float(machine.steps_per_mm[motor.column])
            pin = simulator.pin(Pin.of(axis.step[0]).name)
            counts[letter] = pin, (1.0 if motor.forward else -1.0) / scale

    def along(name: str) -> float:
        pin, scale = counts.get(name, (-1, 0.0))
        return scale * simulator.positions.get(pin, 0)

    # The sensor's own axes: those of the machine, turned.
    turned = {
        name[-1]: (letter, name[0] == "-")
        for letter, name in zip("xyz", table.axes_map, strict=True)
    }
    given = dict.fromkeys("xyz", MODES) if modes is None else modes

    def place() -> tuple[float, float, float]:
        x, y, z = (
            (-1.0 if reverse else 1.0) * along(letter)
            for letter, reverse in (turned[own] for own in "xyz")
        )
        return x, y, z

    def now() -> float:
        return simulator.now

    model = AccelerometerModel(place, now, {own: given.get(turned[own][0], ()) for own in "xyz"})
    simulator.spi[simulator.pin(Pin.of(table.select).name)] = model
    simulator.reader_of = lambda oid, _: BulkReader(simulator, oid, model)
    return model

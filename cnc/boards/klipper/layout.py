"""Objects of a Klipper board for a machine: motors, inputs, outputs, and their configuration."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from cnc.boards.klipper.protocol import Dictionary, LocalError, Value
from cnc.boards.protocols import board_error
from cnc.machine.klipper import Accelerometer, KlipperAxis, KlipperBoard, Pin, TrinamicDriver
from cnc.machine.load import error_in
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic, UsageError

MAX_DURATION_S = 0.4
"""Time after which the board switches an output off, if it hears nothing of it.

With the time by which an update is sent ahead, this is half a second.
"""
EXPIRED, EMERGENCY, BY_HOST, ARMED, LIMIT = 1, 2, 3, 4, 16
"""Reasons of a trigger; LIMIT plus the column is the limit switch of an axis."""
UART_BAUD, SLOW_UART_BAUD = 40_000, 9_000
"""Speed of a motor driver's UART, and on an AVR, bits/s."""
SPI_MODE, SPI_RATE = 3, 4_000_000
"""Mode and speed of a motor driver's SPI (TMC5160 data sheet, chapter 4)."""
SENSOR_RATE = 5_000_000
"""Highest speed of the accelerometer's SPI, which has the same mode (ADXL345 data sheet)."""
REQUIRED = (
    "config_stepper",
    "queue_step",
    "set_next_step_dir",
    "reset_step_clock",
    "stepper_get_position",
    "stepper_stop_on_trigger",
    "config_trsync",
    "trsync_start",
    "trsync_set_timeout",
    "trsync_trigger",
    "config_endstop",
    "endstop_home",
    "endstop_query_state",
    "config_digital_out",
    "queue_digital_out",
)
"""Commands that the firmware must have."""


@dataclass(frozen=True, slots=True)
class MotorObject:
    """A motor.

    Attributes:
        oid: Its object.
        column: Column of its axis.
        forward: Level of its direction pin for positive steps.
        number: Its number among the motors of the axis, from 0.
    """

    oid: int
    column: int
    forward: int
    number: int = 0


@dataclass(frozen=True, slots=True)
class InputObject:
    """An input.

    Attributes:
        oid: Its object.
        name: "probe", "e-stop" or "limit".
        active: Level of the pin while it is pressed.
        reason: Reason that it gives when it triggers.
        column: Column of the axis of a limit switch, else -1.
        motor: Motor of the axis whose own limit switch it is.
    """

    oid: int
    name: str
    active: int
    reason: int
    column: int = -1
    motor: int = 0


@dataclass(frozen=True, slots=True)
class OutputObject:
    """An output.

    Attributes:
        oid: Its object.
        name: "spindle", "backward", "flood", "mist", "fan" or "enable".
        inverted: Whether it is on at the low level.
        full: Value of a PWM that is always on; 1 for a digital output.
        pwm: Whether it is a PWM output.
        limited: Whether the board switches it off after MAX_DURATION_S.
    """

    oid: int
    name: str
    inverted: bool
    full: int = 1
    pwm: bool = False
    limited: bool = True

    def value(self, share: float) -> int:
        """Return the value of the output for a share of full power."""
        value = min(max(round(share * self.full), 0), self.full)
        return self.full - value if self.inverted else value


@dataclass(slots=True)
class Layout:
    """Objects of a board.

    Attributes:
        trigger: Object of the trigger that stops the motors.
        motors: The motors, in the order of the axes.
        inputs: The inputs.
        outputs: The outputs.
        objects: Number of objects.
        config: Encoded commands that configure them, but for allocation and end.
        drivers: Object of the UART or SPI device of the driver of each motor, by letter and number.
        scales: Steps per mm of each axis.
        accelerometer: Objects of the SPI device and of the accelerometer; None without one.
    """

    trigger: int = 0
    motors: list[MotorObject] = field(default_factory=list)
    inputs: list[InputObject] = field(default_factory=list)
    outputs: list[OutputObject] = field(default_factory=list)
    objects: int = 0
    config: list[bytes] = field(default_factory=list)
    drivers: dict[tuple[str, int], int] = field(default_factory=dict)
    scales: tuple[float, ...] = ()
    accelerometer: tuple[int, int] | None = None

    @property
    def crc(self) -> int:
        """Checksum of the configuration and of the motors, by which a program recognises it.

        The board does not know directions and scales, but they decide what its counts mean.
        """
        motors = f"{self.motors} {self.scales} {self.objects}"
        return zlib.crc32(b"".join(self.config) + motors.encode()) or 1

    def limits(self, column: int) -> list[InputObject]:
        """Return the limit switches of an axis, in the order of its motors."""
        return [switch for switch in self.inputs if switch.column == column]

    def input(self, name: str) -> InputObject | None:
        """Return an input by its name."""
        return next((candidate for candidate in self.inputs if candidate.name == name), None)


def section(machine: Machine) -> KlipperBoard:
    """Return the Klipper table of a machine.

    Raises:
        UsageError: ``klipper-pins``, if the machine file has none.
    """
    table = machine.board.klipper
    if table is None:
        hint = (
            "write the tables [board.klipper.x], ... with step and direction; "
            "cncrun boards lists the pins of a board"
        )
        message = "the machine file does not tell the pins of the Klipper board"
        raise UsageError(Diagnostic("klipper-pins", message, hint=hint))
    return table


class LayoutBuilder:
    """Makes the objects of a machine on a board with a dictionary."""

    def __init__(self, machine: Machine, dictionary: Dictionary) -> None:
        self._machine, self._dictionary = machine, dictionary
        self._known = section(machine)
        self._ticks = dictionary.constant("CLOCK_FREQ")
        self._uarts: dict[int, int] = {}
        self._buses: set[str] = set()
        self._used: dict[str, tuple[str, ...]] = {}
        self.layout = Layout(scales=tuple(machine.steps_per_mm.tolist()))

    def build(self) -> Layout:
        """Return the layout.

        Raises:
            MachineFileError: A pin is not one of the board.
            BoardError: ``klipper-command``, if the firmware lacks a command.
        """
        missing = [name for name in REQUIRED if name not in self._dictionary.command_names]
        if missing:
            hint = "install a present version of the firmware"
            message = f"the firmware of the board has no command {missing[0]}"
            raise board_error("klipper-command", message, hint=hint)
        layout = self.layout
        layout.trigger = self._create("config_trsync")
        enables: set[str] = set()
        for column, letter in enumerate(self._machine.axes):
            axis = self._known.axis(letter)
            if axis is None:
                hint = f"write the table [board.klipper.{letter}] with step and direction"
                message = f"the axis {letter} has no motor on the Klipper board"
                raise UsageError(Diagnostic("klipper-pins", message, hint=hint))
            self._motors(letter, column, axis)
            self._enable(letter, axis, enables)
            for number, driver in enumerate(axis.driver or ()):
                self._driver(letter, number, driver)
            for number, text in enumerate(axis.endstop or ()):
                self._limit(letter, column, number, text)
        table = self._known
        if table.probe is not None:
            self._input(("probe",), "probe", table.probe, ARMED)
        if table.emergency_stop is not None:
            self._input(("emergency_stop",), "e-stop", table.emergency_stop, EMERGENCY)
        if table.spindle is not None:
            spindle = table.spindle
            if spindle.pwm:
                self._pwm(("spindle", "pin"), spindle.pin, spindle.frequency)
            else:
                self._digital(("spindle", "pin"), "spindle", spindle.pin)
            if spindle.backward is not None:
                self._digital(("spindle", "backward"), "backward", spindle.backward)
        for name in ("flood", "mist", "fan"):
            pin = getattr(table, name)
            if pin is not None:
                self._digital((name,), name, pin)
        if table.accelerometer is not None:
            spi = self._spi(("accelerometer",), table.accelerometer, SENSOR_RATE)
            layout.accelerometer = spi, self._create("config_adxl345", spi_oid=spi)
        self._check_buses()
        return layout

    def pin(self, key: tuple[str, ...], text: str) -> int:
        """Return the number of a pin."""
        name = Pin.of(text).name
        number = self._dictionary.number("pin", name)
        if number is None:
            pins = self._dictionary.enumerations.get("pin", {})
            hint = f"its pins are {pin_ranges(pins)}"
            message = f"the board has no pin {name}"
            raise error_in(self._machine, ("board", "klipper", *key), message, hint)
        self._used[name] = key
        return number

    def _check_buses(self) -> None:
        """Check that nothing else uses the pins of an SPI bus, if the firmware names them."""
        for bus in sorted(self._buses):
            for name in str(self._dictionary.constants.get(f"BUS_PINS_{bus}", "")).split(","):
                if name in self._used:
                    path = ("board", "klipper", *self._used[name])
                    message = f"the pin {name} belongs to the SPI bus {bus}"
                    raise error_in(self._machine, path, message, "give each pin one use")

    def encode(self, command: str, **values: Value) -> None:
        """Append a command to the configuration."""
        try:
            self.layout.config.append(self._dictionary.encode(command, **values))
        except LocalError as error:
            hint = "install a present version of the firmware"
            raise board_error("klipper-command", str(error), hint=hint) from error

    def _create(self, command: str, **values: Value) -> int:
        oid = self.layout.objects
        self.encode(command, oid=oid, **values)
        self.layout.objects += 1
        return oid

    def _motors(self, letter: str, column: int, axis: KlipperAxis) -> None:
        pulse = max(1, round(self._machine.board.step_pulse * self._ticks))
        table = next(entry for name, entry in self._machine.axes.items() if name == letter)
        for number, (step, direction) in enumerate(zip(axis.step, axis.direction, strict=True)):
            invert = table.invert
            if number < len(table.motors):
                invert ^= table.motors[number].invert
            oid = self._create(
                "config_stepper",
                step_pin=self.pin((letter, "step"), step),
                dir_pin=self.pin((letter, "direction"), direction),
                invert_step=int(Pin.of(step).inverted),
                step_pulse_ticks=pulse,
            )
            backward = Pin.of(direction).inverted != invert
            self.layout.motors.append(MotorObject(oid, column, int(not backward), number))

    def _enable(self, letter: str, axis: KlipperAxis, done: set[str]) -> None:
        for text in axis.enable or ():
            pin = Pin.of(text)
            if pin.name in done:
                continue
            done.add(pin.name)
            # In a shutdown the motors keep their torque: a Z axis must not fall.
            off, on = int(pin.inverted), int(not pin.inverted)
            oid = self._create(
                "config_digital_out",
                pin=self.pin((letter, "enable"), text),
                value=off,
                default_value=on,
                max_duration=0,
            )
            self.layout.outputs.append(OutputObject(oid, "enable", pin.inverted, limited=False))

    def _driver(self, letter: str, number: int, driver: TrinamicDriver) -> None:
        """Configure the UART or SPI device of a motor driver; drivers may share a UART."""
        key = letter, "driver"
        if driver.uart is not None:
            pin = self.pin((*key, "uart"), driver.uart)
            if pin not in self._uarts:
                slow = str(self._dictionary.constants.get("MCU", "")).startswith("at")
                baud = SLOW_UART_BAUD if slow else UART_BAUD
                self._uarts[pin] = self._create(
                    "config_tmcuart",
                    rx_pin=pin,
                    pull_up=int(Pin.of(driver.uart).pull_up),
                    tx_pin=self.pin((*key, "transmit"), driver.transmit or driver.uart),
                    bit_time=round(self._ticks / baud),
                )
            self.layout.drivers[letter, number] = self._uarts[pin]
        elif driver.select is not None:
            self.layout.drivers[letter, number] = self._spi(key, driver, SPI_RATE)

    def _spi(self, key: tuple[str, ...], table: TrinamicDriver | Accelerometer, rate: int) -> int:
        """Create the SPI device of a table of the machine file; return its object."""
        assert table.select is not None
        buses = self._dictionary.enumerations.get("spi_bus", {})
        bus = buses.get(table.spi_bus, min(buses.values(), default=0))
        self._buses |= {name for name, number in buses.items() if number == bus}
        if table.spi_bus and table.spi_bus not in buses:
            message = f"the board has no SPI bus {table.spi_bus}"
            hint = f"its buses are {', '.join(buses) or 'none'}"
            path = ("board", "klipper", *key, "spi_bus")
            raise error_in(self._machine, path, message, hint)
        oid = self._create(
            "config_spi",
            pin=self.pin((*key, "select"), table.select),
            cs_active_high=int(Pin.of(table.select).inverted),
        )
        self.encode("spi_set_bus", oid=oid, spi_bus=bus, mode=SPI_MODE, rate=rate)
        return oid

    def _limit(self, letter: str, column: int, number: int, text: str) -> None:
        pin = Pin.of(text)
        key = letter, "endstop"
        oid = self._create("config_endstop", pin=self.pin(key, text), pull_up=int(pin.pull_up))
        active = int(not pin.inverted)
        self.layout.inputs.append(InputObject(oid, "limit", active, LIMIT + column, column, number))

    def _input(self, key: tuple[str, ...], name: str, text: str, reason: int) -> None:
        pin = Pin.of(text)
        oid = self._create("config_endstop", pin=self.pin(key, text), pull_up=int(pin.pull_up))
        self.layout.inputs.append(InputObject(oid, name, int(not pin.inverted), reason))

    def _digital(self, key: tuple[str, ...], name: str, text: str) -> None:
        pin = Pin.of(text)
        off = int(pin.inverted)
        oid = self._create(
            "config_digital_out",
            pin=self.pin(key, text),
            value=off,
            default_value=off,
            max_duration=round(MAX_DURATION_S * self._ticks),
        )
        self.layout.outputs.append(OutputObject(oid, name, pin.inverted))

    def _pwm(self, key: tuple[str, ...], text: str, frequency: float) -> None:
        pin = Pin.of(text)
        full = round(self._dictionary.constant("PWM_MAX", 255.0))
        off = full if pin.inverted else 0
        oid = self._create(
            "config_pwm_out",
            pin=self.pin(key, text),
            cycle_ticks=round(self._ticks / frequency),
            value=off,
            default_value=off,
            max_duration=round(MAX_DURATION_S * self._ticks),
        )
        self.layout.outputs.append(OutputObject(oid, "spindle", pin.inverted, full, pwm=True))


def pin_ranges(pins: Mapping[str, int]) -> str:
    """Return the names of pins, with runs such as PA0 to PA15 shortened."""
    return ", ".join(_runs(pins)) or "none"


def _runs(pins: Mapping[str, int]) -> Iterator[str]:
    names = sorted(pins, key=lambda name: pins[name])
    at = 0
    while at < len(names):
        stem = names[at].rstrip("0123456789")
        end = at
        while (
            end + 1 < len(names)
            and names[end + 1].rstrip("0123456789") == stem
            and pins[names[end + 1]] == pins[names[end]] + 1
        ):
            end += 1
        yield names[at] if end == at else f"{names[at]} to {names[end]}"
        at = end + 1

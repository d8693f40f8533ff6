"""The table [board.klipper] of a machine file: pins and motor drivers of a Klipper board.

Pins have Klipper's notation: ``!`` inverts the pin, ``^`` switches a pull-up resistor on. Their
names are those of the firmware, such as PA3 or gpio11.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, FiniteFloat, WithJsonSchema

from cnc.model.blocks import AXIS_LETTERS
from cnc.model.section import Inconsistency, Section, as_tuple

_PIN = re.compile(r"([\^!]*)([A-Za-z][A-Za-z0-9_.]*)")


@dataclass(frozen=True, slots=True)
class Pin:
    """A pin: its name, whether it is inverted, and whether it has a pull-up resistor."""

    name: str
    inverted: bool
    pull_up: bool

    @classmethod
    def of(cls, text: str) -> Pin:
        """Return the pin of a text that :func:`_pin` accepts."""
        match = _PIN.fullmatch(text)
        assert match is not None
        return cls(match[2], "!" in match[1], "^" in match[1])


def _pin(text: str) -> str:
    match = _PIN.fullmatch(text)
    if match is None or match[1].count("!") > 1 or match[1].count("^") > 1:
        raise ValueError("must be the name of a pin, such as PA3, !PA3 or ^!gpio4")
    return text


def _pins(value: Any) -> Any:
    """Return one pin, or a list of pins, as a tuple."""
    return (value,) if isinstance(value, str) else as_tuple(value)


def _output(text: str) -> str:
    if "^" in text:
        raise ValueError("an output has no pull-up resistor: remove ^")
    return text


InputPin = Annotated[str, AfterValidator(_pin)]
OutputPin = Annotated[str, AfterValidator(_pin), AfterValidator(_output)]
_PINS = WithJsonSchema(
    {
        "anyOf": [
            {"type": "string"},
            {"type": "array", "items": {"type": "string"}, "minItems": 1, "maxItems": 4},
        ]
    }
)
_ONE_TO_FOUR = Field(min_length=1, max_length=4)
OutputPins = Annotated[tuple[OutputPin, ...], BeforeValidator(_pins), _ONE_TO_FOUR, _PINS]
InputPins = Annotated[tuple[InputPin, ...], BeforeValidator(_pins), _ONE_TO_FOUR, _PINS]


class TrinamicDriver(Section):
    """A motor driver that the board configures, by a UART or by SPI."""

    kind: Literal["tmc2208", "tmc2209", "tmc2130", "tmc5160"] = Field(
        description="Driver: tmc2208 and tmc2209 have a UART, tmc2130 and tmc5160 have SPI."
    )
    uart: InputPin | None = Field(default=None, description="Pin of the UART.")
    transmit: OutputPin | None = Field(
        default=None,
        description="Pin on which the board sends to the UART; by default the pin of the UART.",
    )
    address: Annotated[int, Field(ge=0, le=3)] = Field(
        default=0, description="Address on a UART that several tmc2209 share."
    )
    select: OutputPin | None = Field(default=None, description="Pin of the chip select of SPI.")
    spi_bus: str = Field(default="", description="Name of the SPI bus; by default the first one.")
    run_current: Annotated[FiniteFloat, Field(gt=0, le=10)] = Field(
        description="Current of a moving motor, A (RMS)."
    )
    hold_current: Annotated[FiniteFloat, Field(gt=0, le=10)] | None = Field(
        default=None, description="Current of a motor at rest, A (RMS); by default run_current."
    )
    sense_resistor: Annotated[FiniteFloat, Field(gt=0, le=1)] | None = Field(
        default=None,
        description="Sense resistor, ohm; by default 0.11, for tmc5160 0.075.",
    )
    microsteps: Literal[1, 2, 4, 8, 16, 32, 64, 128, 256] = Field(
        default=16, description="Microsteps of a full step."
    )
    stealthchop: bool = Field(default=False, description="Whether the driver runs silently.")
    stallguard: Annotated[int, Field(ge=-64, le=255)] | None = Field(
        default=None,
        description=(
            "Sensitivity of StallGuard for homing without a switch: 0 to 255 (tmc2209), -64 to 63 "
            "(tmc2130, tmc5160). The driver's DIAG output is then the endstop pin."
        ),
    )

    @property
    def has_uart(self) -> bool:
        """Whether the driver is configured by a UART."""
        return self.kind in ("tmc2208", "tmc2209")

    @property
    def resistor(self) -> float:
        """Sense resistor, ohm."""
        usual = 0.075 if self.kind == "tmc5160" else 0.11
        return usual if self.sense_resistor is None else self.sense_resistor


def _drivers(value: Any) -> Any:
    """Return one table of a driver, or a list of tables, as a tuple."""
    return (value,) if isinstance(value, dict | TrinamicDriver) else as_tuple(value)


_DRIVER_SCHEMA = {
    "type": "object",
    "properties": {
        name: {"description": field.description}
        for name, field in TrinamicDriver.model_fields.items()
    },
    "required": ["kind", "run_current"],
    "additionalProperties": False,
}
Drivers = Annotated[
    tuple[TrinamicDriver, ...],
    BeforeValidator(_drivers),
    _ONE_TO_FOUR,
    WithJsonSchema(
        {
            "anyOf": [
                _DRIVER_SCHEMA,
                {"type": "array", "items": _DRIVER_SCHEMA, "minItems": 1, "maxItems": 4},
            ]
        }
    ),
]


class KlipperAxis(Section):
    """Pins of the motors of an axis. An axis with several motors has lists of pins."""

    step: OutputPins = Field(description="Step pin; a list for several motors.")
    direction: OutputPins = Field(description="Direction pin of each motor.")
    enable: OutputPins | None = Field(
        default=None, description="Enable pin; motors may share one. Without it: always on."
    )
    endstop: InputPins | None = Field(
        default=None,
        description=(
            "Pin of the limit switch, which is high when it is pressed. A list has the switch of "
            "each motor, by which homing squares the gantry."
        ),
    )
    driver: Drivers | None = Field(
        default=None,
        description="Motor driver that the board configures; a list for several motors.",
    )


class KlipperSpindle(Section):
    """The spindle: a relay, or an analogue input by PWM."""

    pin: OutputPin = Field(description="Pin of the relay or of the PWM.")
    pwm: bool = Field(default=False, description="Whether the speed is set by PWM.")
    frequency: Annotated[FiniteFloat, Field(ge=10, le=100_000)] = Field(
        default=1000.0, description="Frequency of the PWM, Hz."
    )
    backward: OutputPin | None = Field(
        default=None, description="Pin that is on while the spindle turns backward (M4)."
    )


AXES_OF_SENSOR = frozenset(sign + axis for axis in "xyz" for sign in ("", "-"))


def _axes_map(axes: tuple[str, ...]) -> tuple[str, ...]:
    if not AXES_OF_SENSOR.issuperset(axes) or {axis[-1] for axis in axes} != set("xyz"):
        raise ValueError(
            'must have x, y and z once, each with or without -, such as ["y", "-x", "z"]'
        )
    return axes


class Accelerometer(Section):
    """An ADXL345 at the tool or the table, on an SPI bus of the board."""

    select: OutputPin = Field(description="Pin of its chip select (CS).")
    spi_bus: str = Field(default="", description="Name of the SPI bus; by default the first one.")
    axes_map: Annotated[
        tuple[str, ...],
        BeforeValidator(as_tuple),
        Field(min_length=3, max_length=3),
        AfterValidator(_axes_map),
    ] = Field(
        default=("x", "y", "z"),
        description="The axis of the sensor along X, Y and Z of the machine, such as -z.",
    )
    rate: Literal[400, 800, 1600, 3200] = Field(
        default=3200, description="Samples per second; a serial line needs a lower rate."
    )


class KlipperBoard(Section):
    """A Klipper board: its pins, motor drivers and tolerances."""

    mcu: str = Field(
        default="rp2040",
        description=(
            "Microcontroller that checks and the simulator assume: atmega328p, atmega2560, rp2040, "
            "stm32f103 or stm32f446. A real board tells its own."
        ),
    )
    tolerance_us: Annotated[FiniteFloat, Field(ge=0, le=100)] = Field(
        default=5.0, description="Largest deviation of a step from its time, us."
    )
    x: KlipperAxis | None = Field(default=None, description="Motors of X.")
    y: KlipperAxis | None = Field(default=None, description="Motors of Y.")
    z: KlipperAxis | None = Field(default=None, description="Motors of Z.")
    a: KlipperAxis | None = Field(default=None, description="Motors of A.")
    b: KlipperAxis | None = Field(default=None, description="Motors of B.")
    c: KlipperAxis | None = Field(default=None, description="Motors of C.")
    u: KlipperAxis | None = Field(default=None, description="Motors of U.")
    v: KlipperAxis | None = Field(default=None, description="Motors of V.")
    w: KlipperAxis | None = Field(default=None, description="Motors of W.")
    spindle: KlipperSpindle | None = Field(default=None, description="The spindle.")
    flood: OutputPin | None = Field(default=None, description="Pin of the flood coolant (M8).")
    mist: OutputPin | None = Field(default=None, description="Pin of the mist coolant (M7).")
    fan: OutputPin | None = Field(
        default=None, description="Pin of a fan that is on while a program runs."
    )
    probe: InputPin | None = Field(
        default=None, description="Pin of the probe, which is high in contact."
    )
    emergency_stop: InputPin | None = Field(
        default=None, description="Pin of the e-stop, which is high when it is pressed."
    )
    accelerometer: Accelerometer | None = Field(
        default=None, description="An ADXL345, for cncrun measure ringing."
    )

    def axis(self, letter: str) -> KlipperAxis | None:
        """Return the motors of an axis, or of a joint with such a name."""
        table: KlipperAxis | None = getattr(self, letter) if letter in AXIS_LETTERS else None
        return table

    def pins(self) -> Iterator[tuple[tuple[str, ...], str, str]]:
        """Yield key, use and text of each pin. Pins of the same use "enable" may be shared."""
        for letter in AXIS_LETTERS:
            axis = self.axis(letter)
            if axis is None:
                continue
            for name in ("step", "direction", "enable", "endstop"):
                for pin in getattr(axis, name) or ():
                    yield (letter, name), name, pin
            for driver in axis.driver or ():
                for name in ("uart", "transmit", "select"):
                    pin = getattr(driver, name)
                    if pin is not None:
                        use = name if name == "select" else f"{name} {driver.address}"
                        yield (letter, "driver", name), use, pin
        if self.spindle is not None:
            yield ("spindle", "pin"), "spindle", self.spindle.pin
            if self.spindle.backward is not None:
                yield ("spindle", "backward"), "spindle backward", self.spindle.backward
        for name in ("flood", "mist", "fan", "probe", "emergency_stop"):
            pin = getattr(self, name)
            if pin is not None:
                yield (name,), name, pin
        if self.accelerometer is not None:
            yield ("accelerometer", "select"), "accelerometer", self.accelerometer.select

    def inconsistencies(self, axes: Mapping[str, int]) -> Iterator[Inconsistency]:
        """Yield the contradictions between keys.

        Args:
            axes: Number of motors of each axis (joint) of the machine; 1 where none is given.
        """
        for letter in AXIS_LETTERS:
            axis, key = self.axis(letter), ("board", "klipper", letter)
            if axis is None:
                if letter in axes:
                    yield Inconsistency(
                        ("board", "klipper"),
                        f"the axis {letter} has no motor",
                        f"write the table [board.klipper.{letter}] with step and direction",
                    )
                continue
            if letter not in axes:
                yield Inconsistency(
                    key, f"the machine has no axis {letter}", f"its axes are {', '.join(axes)}"
                )
            yield from _counts(axis, key)
            yield from _motors(axis, letter, axes.get(letter, 1))
        for name in axes:
            if name not in AXIS_LETTERS:
                yield Inconsistency(
                    ("board", "klipper"),
                    f"the joint {name} cannot have a motor on a Klipper board",
                    f"joints with motors are named {', '.join(AXIS_LETTERS)}",
                )
        yield from self._shared()

    def _shared(self) -> Iterator[Inconsistency]:
        """Yield the pins that are claimed twice."""
        claimed: dict[str, tuple[tuple[str, ...], str, str]] = {}
        for key, use, text in self.pins():
            name = Pin.of(text).name
            if name not in claimed:
                claimed[name] = key, use, text
                continue
            owner, owner_use, owner_text = claimed[name]
            shared_enable = use == owner_use == "enable" and text == owner_text
            both_uart = use.split()[0] == owner_use.split()[0] in ("uart", "transmit")
            if shared_enable or (both_uart and use != owner_use):
                continue
            yield Inconsistency(
                ("board", "klipper", *key),
                f"the pin {name} is used by board.klipper.{'.'.join(owner)} already",
                "give each pin one use",
            )


def _counts(axis: KlipperAxis, key: tuple[str, ...]) -> Iterator[Inconsistency]:
    """Yield lists of pins whose lengths do not match, and drivers without a connection."""
    motors = len(axis.step)
    if len(axis.direction) != motors:
        yield Inconsistency(
            (*key, "direction"),
            f"{motors} motors have {len(axis.direction)} direction pins",
            "give one pin for each motor",
        )
    if axis.enable is not None and len(axis.enable) not in (1, motors):
        yield Inconsistency(
            (*key, "enable"),
            f"{motors} motors have {len(axis.enable)} enable pins",
            "give one pin for all motors, or one for each",
        )
    if axis.endstop is not None and len(axis.endstop) not in (1, motors):
        yield Inconsistency(
            (*key, "endstop"),
            f"{motors} motors have {len(axis.endstop)} limit switches",
            "give one pin for all motors, or one for each",
        )
    if axis.driver is not None and len(axis.driver) != motors:
        yield Inconsistency(
            (*key, "driver"),
            f"{motors} motors have {len(axis.driver)} drivers",
            "give a list with one table for each motor",
        )
    for driver in axis.driver or ():
        yield from _driver(driver, axis, key)


def _motors(axis: KlipperAxis, letter: str, motors: int) -> Iterator[Inconsistency]:
    """Compare the pins with the motors of the machine's axis."""
    if motors > 1 and len(axis.step) != motors:
        yield Inconsistency(
            ("board", "klipper", letter, "step"),
            f"the axis {letter} has {motors} motors, but {len(axis.step)} step pins",
            "give one pin for each motor",
        )
    if motors == 1 and axis.endstop is not None and len(axis.endstop) > 1:
        yield Inconsistency(
            ("board", "klipper", letter, "endstop"),
            f"the axis {letter} has {len(axis.endstop)} limit switches, but one motor",
            f"write motors = {len(axis.endstop)} into the table of the axis",
        )


def _driver(
    driver: TrinamicDriver, axis: KlipperAxis, key: tuple[str, ...]
) -> Iterator[Inconsistency]:
    """Yield the contradictions of a motor driver."""
    wanted, other = ("uart", "select") if driver.has_uart else ("select", "uart")
    if getattr(driver, wanted) is None:
        yield Inconsistency(
            (*key, "driver"), f"a {driver.kind} needs the pin {wanted}", f"add {wanted} = ..."
        )
    if getattr(driver, other) is not None:
        yield Inconsistency(
            (*key, "driver", other), f"a {driver.kind} has no {other}", f"remove {other}"
        )
    if driver.transmit is not None and not driver.has_uart:
        yield Inconsistency(
            (*key, "driver", "transmit"), f"a {driver.kind} has no transmit", "remove transmit"
        )
    if driver.stallguard is not None:
        least, most = (0, 255) if driver.has_uart else (-64, 63)
        if driver.kind == "tmc2208":
            message, hint = "a tmc2208 has no StallGuard", "remove stallguard, and use a switch"
            yield Inconsistency((*key, "driver", "stallguard"), message, hint)
        elif not least <= driver.stallguard <= most:
            yield Inconsistency(
                (*key, "driver", "stallguard"),
                f"{driver.stallguard} is outside {least} to {most}",
                f"give a value that a {driver.kind} has",
            )
        if axis.endstop is None:
            yield Inconsistency(
                (*key, "driver", "stallguard"),
                "the axis has no endstop pin",
                "name the pin of the driver's DIAG output: endstop = ...",
            )

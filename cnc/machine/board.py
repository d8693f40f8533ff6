"""The table [board] of a machine file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, FiniteFloat

from cnc.machine.klipper import KlipperBoard
from cnc.model.section import Positive, Section, as_tuple

InputName = Literal["limits", "probe", "emergency-stop", "hold", "resume"]
"""Inputs of the stepper board that have a switch; ``limits`` are the switches of all axes."""
PulseTime = Annotated[FiniteFloat, Field(gt=0, le=60e-6)]
"""Seconds, within the range of the board's 8-bit timer."""


class Board(Section):
    """The board that takes the motion.

    ``max_spindle_rpm`` and the keys after it are for the stepper board. GRBL has its own settings.
    """

    kind: Annotated[str, Field(min_length=1)] = Field(
        default="loopback",
        description="Name of the board driver, such as loopback, file, grbl, stepper or klipper.",
    )
    port: str | None = Field(
        default=None,
        description=(
            "Serial port of the board, such as /dev/ttyUSB0 or COM3; usb:NUMBER for the device "
            "with this serial number; a pyserial URL such as socket://host:port; a WebSocket such "
            "as ws://host:port; or the file of the file board."
        ),
    )
    baud: Annotated[int, Field(gt=0)] = Field(
        default=115200,
        description=(
            "Speed of the serial port, bits/s. Without it, a stepper board has 1000000, a Klipper "
            "board 250000."
        ),
    )
    max_step_rate: Positive = Field(
        default=200_000.0, description="Highest step rate of one axis, steps/s."
    )
    max_spindle_rpm: Positive = Field(
        default=1000.0,
        description="Speed of a PWM spindle while its output (D11) is on all the time, rpm.",
    )
    normally_closed: Annotated[tuple[InputName, ...], BeforeValidator(as_tuple)] = Field(
        default=(),
        description=(
            "Inputs with a switch that opens when it is pressed, so that a broken wire "
            "counts as pressed (limits: $5 = 1 in GRBL, probe: $6 = 1)."
        ),
    )
    invert_enable: bool = Field(
        default=False,
        description=(
            "Whether the motor drivers are on while the enable pin (D8) is high ($4 = 1 in GRBL)."
        ),
    )
    step_pulse: PulseTime = Field(
        default=5e-6,
        description="Time for which a step pin stays high ($0 in GRBL), and low after that, s.",
    )
    direction_setup: PulseTime = Field(
        default=5e-6, description="Time from a change of direction to the next step, s."
    )
    klipper: KlipperBoard | None = Field(
        default=None, description="Pins and motor drivers of a Klipper board."
    )

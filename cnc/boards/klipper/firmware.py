"""Firmware profiles: clock, queue, speed and pins of some microcontrollers, and their dictionary.

They stand in ``firmware.toml``, with their sources.
"""

from __future__ import annotations

import json
import tomllib
import zlib
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any

from cnc.boards.klipper.protocol import IDENTIFY, IDENTIFY_RESPONSE, Dictionary

_TABLES = tomllib.loads(files(__package__).joinpath("firmware.toml").read_text(encoding="utf-8"))
COMMANDS: list[str] = _TABLES["commands"]
RESPONSES: list[str] = _TABLES["responses"]
REASONS: list[str] = _TABLES["reasons"]
"""Reasons of a shutdown, in the order of their numbers from 2."""
FORGET = "reset", "config_reset"
MESSAGES = 0.06
"""Least share of the processor's time for messages: steps and samples leave it."""
LEAST_FREE = 0.1
"""Least share of the processor's time for steps, with many inputs."""


@dataclass(frozen=True)
class Firmware:
    """A microcontroller with the firmware.

    Attributes:
        mcu: Name of the microcontroller.
        frequency: Ticks of its clock per second.
        slots: Entries of its move queue.
        baud: Speed of its serial line, bits/s; 0 for USB.
        event_ticks: Time that an edge of a step pin takes as an event of its own, ticks.
        ports: First names of the pins, and number of pins of each.
        buses: SPI buses in the order of their numbers, each with its pins MISO, MOSI, SCK.
        window: Bytes that it can receive ahead; 0 for USB.
        pwm_max: Value of a PWM output that is always on.
        short_pulse: Longest step pulse whose end is no event of its own, ticks.
        short_ticks: Time of a step with such a pulse, ticks.
        sample_ticks: Time of a sample of a switch, ticks; 0 if it is that of an event.
        byte_ticks: Time of a received byte, ticks: interrupt, command, answer; 0 if it is little.
        forgets_by: Command after which it forgets its configuration: "reset", which most boards
            have, or "config_reset", which does not restart it.
    """

    mcu: str
    frequency: int
    slots: int
    baud: int
    event_ticks: int
    ports: list[tuple[str, int]]
    buses: list[tuple[str, str]]
    window: int
    pwm_max: int = 255
    short_pulse: int = 0
    short_ticks: int = 0
    sample_ticks: int = 0
    byte_ticks: int = 0
    forgets_by: str = "reset"

    def events(self, pulse: int) -> int:
        """Return the number of events of a step with a pulse, ticks: its edges, or just one."""
        return 1 if pulse <= self.short_pulse else 2

    def event_time(self, pulse: int, samples: float) -> float:
        """Return the time of an event of a step, ticks, when other work takes its share.

        Args:
            pulse: The pulse, ticks.
            samples: Samples of switches in a tick.
        """
        own = self.short_ticks if pulse <= self.short_pulse else self.event_ticks
        return own / self.free(samples)

    def free(self, samples: float) -> float:
        """Return the share of the processor's time that samples and messages leave for steps."""
        free = 1.0 - MESSAGES - samples * (self.sample_ticks or self.event_ticks)
        return max(free, LEAST_FREE)

    def message_share(self, steps: float, samples: float) -> float:
        """Return the share of the processor's time that is left for messages.

        Args:
            steps: Share that steps take of what is free for them.
            samples: Samples of switches in a tick.
        """
        return MESSAGES + max(1.0 - steps, 0.0) * self.free(samples)

    @cached_property
    def content(self) -> dict[str, Any]:
        """The dictionary as JSON."""
        numbers = iter(range(2, 128))
        pins: dict[str, Any] = {}
        first = 0
        for name, count in self.ports:
            pins[name] = [first, count]
            first += count
        constants: dict[str, Any] = {
            "MCU": self.mcu,
            "CLOCK_FREQ": self.frequency,
            "PWM_MAX": self.pwm_max,
            "STATS_SUMSQ_BASE": 256,
        }
        constants |= {f"BUS_PINS_{name}": pins for name, pins in self.buses}
        if self.baud:
            constants |= {"SERIAL_BAUD": self.baud, "RECEIVE_WINDOW": self.window}
        commands = [text for text in COMMANDS if text not in FORGET or text == self.forgets_by]
        return {
            "app": "klipper-sim",
            "version": "simulator",
            "build_versions": "",
            "commands": {IDENTIFY: 1} | {text: next(numbers) for text in commands},
            "responses": {IDENTIFY_RESPONSE: 0} | {text: next(numbers) for text in RESPONSES},
            "config": constants,
            "enumerations": {
                "pin": pins,
                "spi_bus": {name: number for number, (name, _) in enumerate(self.buses)},
                "static_string_id": {text: 2 + k for k, text in enumerate(REASONS)},
            },
        }

    @cached_property
    def identify(self) -> bytes:
        """The bytes that ``identify`` gives."""
        return zlib.compress(json.dumps(self.content).encode(), 9)

    @cached_property
    def dictionary(self) -> Dictionary:
        """The dictionary."""
        return Dictionary(self.content)

    def reason(self, number: int) -> str:
        """Return the reason of a shutdown by its number."""
        return REASONS[number - 2]


FIRMWARES = {name: Firmware(**table) for name, table in _TABLES["microcontrollers"].items()}
"""Profiles by the name of the microcontroller."""

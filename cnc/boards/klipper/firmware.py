"""Firmware profiles: clock, queue, speed and pins of some microcontrollers, and their dictionary.

Clock frequencies, baud rates and names are those of Klipper's documentation. The time of an event
is that of a step in its benchmarks with three motors (Klipper documentation, Benchmarks), which
make one event of a step. A longer pulse needs two. The times of an AVR were measured with the
firmware itself in a simulated ATmega328P: the benchmarks have no switches.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from cnc.boards.klipper.protocol import IDENTIFY, IDENTIFY_RESPONSE, Dictionary

COMMANDS = (
    "allocate_oids count=%c",
    "get_config",
    "finalize_config crc=%u",
    "config_reset",
    "get_clock",
    "get_uptime",
    "emergency_stop",
    "clear_shutdown",
    "reset",
    "debug_ping data=%*s",
    "config_stepper oid=%c step_pin=%c dir_pin=%c invert_step=%c step_pulse_ticks=%u",
    "queue_step oid=%c interval=%u count=%hu add=%hi",
    "set_next_step_dir oid=%c dir=%c",
    "reset_step_clock oid=%c clock=%u",
    "stepper_get_position oid=%c",
    "stepper_stop_on_trigger oid=%c trsync_oid=%c",
    "config_trsync oid=%c",
    "trsync_start oid=%c report_clock=%u report_ticks=%u expire_reason=%c",
    "trsync_set_timeout oid=%c clock=%u",
    "trsync_trigger oid=%c reason=%c",
    "config_endstop oid=%c pin=%c pull_up=%c",
    "endstop_home oid=%c clock=%u sample_ticks=%u sample_count=%c rest_ticks=%u pin_value=%c"
    " trsync_oid=%c trigger_reason=%c",
    "endstop_query_state oid=%c",
    "config_digital_out oid=%c pin=%u value=%c default_value=%c max_duration=%u",
    "set_digital_out_pwm_cycle oid=%c cycle_ticks=%u",
    "queue_digital_out oid=%c clock=%u on_ticks=%u",
    "update_digital_out oid=%c value=%c",
    "set_digital_out pin=%u value=%c",
    "config_pwm_out oid=%c pin=%u cycle_ticks=%u value=%hu default_value=%hu max_duration=%u",
    "queue_pwm_out oid=%c clock=%u value=%hu",
    "config_tmcuart oid=%c rx_pin=%u pull_up=%c tx_pin=%u bit_time=%u",
    "tmcuart_send oid=%c write=%*s read=%c",
    "config_spi oid=%c pin=%u cs_active_high=%c",
    "spi_set_bus oid=%c spi_bus=%u mode=%u rate=%u",
    "spi_transfer oid=%c data=%*s",
    "spi_send oid=%c data=%*s",
)
FORGET = "reset", "config_reset"
MESSAGES = 0.06
"""Least share of the processor's time for messages: steps and samples leave it."""
LEAST_FREE = 0.1
"""Least share of the processor's time for steps, with many inputs."""
RESPONSES = (
    "config is_config=%c crc=%u is_shutdown=%c move_count=%hu",
    "clock clock=%u",
    "uptime high=%u clock=%u",
    "shutdown clock=%u static_string_id=%hu",
    "is_shutdown static_string_id=%hu",
    "starting",
    "pong data=%*s",
    "stepper_position oid=%c pos=%i",
    "trsync_state oid=%c can_trigger=%c trigger_reason=%c clock=%u",
    "endstop_state oid=%c homing=%c next_clock=%u pin_value=%c",
    "tmcuart_response oid=%c read=%*s",
    "spi_transfer_response oid=%c response=%*s",
)
REASONS = (
    "Timer too close",
    "Rescheduled timer in the past",
    "Move queue overflow",
    "Invalid count parameter",
    "Can't reset time when stepper active",
    "Can't add signal that is already active",
    "Missed scheduling of next digital out event",
    "Scheduled digital out event will exceed max_duration",
    "Missed scheduling of next hard pwm event",
    "Scheduled pwm event will exceed max_duration",
    "oids already allocated",
    "Can't assign oid",
    "Invalid oid type",
    "Already finalized",
    "Not an output pin",
    "Not a valid input pin",
    "config_reset only available when shutdown",
    "Command request",
    "Command parser error",
    "Invalid command",
)
"""Reasons of a shutdown, in the order of their numbers from 2."""


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
    ports: tuple[tuple[str, int], ...]
    buses: tuple[tuple[str, str], ...]
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


def _ports(letters: str, pins: int) -> tuple[tuple[str, int], ...]:
    return tuple((f"P{letter}0", pins) for letter in letters)


RP2040_BUSES = (
    ("spi0a", "gpio0,gpio3,gpio2"),
    ("spi0b", "gpio4,gpio7,gpio6"),
    ("spi0c", "gpio16,gpio19,gpio18"),
    ("spi0d", "gpio20,gpio23,gpio22"),
    ("spi0e", "gpio4,gpio3,gpio2"),
    ("spi1a", "gpio8,gpio11,gpio10"),
    ("spi1b", "gpio12,gpio15,gpio14"),
    ("spi1c", "gpio24,gpio27,gpio26"),
)
SPI1_SPI2 = ("spi2", "PB14,PB15,PB13"), ("spi1", "PA6,PA7,PA5"), ("spi1a", "PB4,PB5,PB3")
STM32F1_BUSES = (*SPI1_SPI2, ("spi3", "PB4,PB5,PB3"))
STM32F4_BUSES = (
    *SPI1_SPI2,
    ("spi2a", "PC2,PC3,PB10"),
    ("spi3", "PB4,PB5,PB3"),
    ("spi3a", "PC11,PC12,PC10"),
    ("spi4", "PE13,PE14,PE12"),
)
"""Names and pins of the SPI buses, as the dictionaries of the firmware have them."""
AVR_PULSE = 40
"""Step pulse up to which an AVR makes both edges in one event, ticks."""
AVR_SHORT, AVR_EDGE, AVR_SAMPLE, AVR_BYTE = 225, 313, 281, 205
"""Times on an AVR, ticks: of a step with such a pulse, of an edge of a longer one, of a sample, of
a received byte.
"""
FIRMWARES = {
    "atmega328p": Firmware(
        "atmega328p",
        16_000_000,
        86,
        250_000,
        AVR_EDGE,
        _ports("ABCD", 8),
        (("spi", "PB4,PB3,PB5"),),
        window=192,
        short_pulse=AVR_PULSE,
        short_ticks=AVR_SHORT,
        sample_ticks=AVR_SAMPLE,
        byte_ticks=AVR_BYTE,
    ),
    "atmega2560": Firmware(
        "atmega2560",
        16_000_000,
        666,
        250_000,
        AVR_EDGE,
        _ports("ABCDEFGHIJKL", 8),
        (("spi", "PB3,PB2,PB1"),),
        window=192,
        short_pulse=AVR_PULSE,
        short_ticks=AVR_SHORT,
        sample_ticks=AVR_SAMPLE,
        byte_ticks=AVR_BYTE,
    ),
    "rp2040": Firmware("rp2040", 12_000_000, 1024, 0, 5, (("gpio0", 30),), RP2040_BUSES, window=0),
    "stm32f103": Firmware(
        "stm32f103xe", 72_000_000, 1024, 0, 88, _ports("ABCDE", 16), STM32F1_BUSES, window=0
    ),
    "stm32f446": Firmware(
        "stm32f446xx", 180_000_000, 1024, 0, 110, _ports("ABCDEFGH", 16), STM32F4_BUSES, window=0
    ),
}
"""Profiles by the name of the microcontroller."""

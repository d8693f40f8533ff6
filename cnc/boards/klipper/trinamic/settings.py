"""Registers of the drivers and their values for a machine file.

Register maps and formulas of the currents: data sheets of TMC2209 (chapters 5 and 9), TMC2130
(chapters 6 and 9) and TMC5160 (chapters 6 and 9).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from cnc.machine.klipper import TrinamicDriver

GCONF, GSTAT, IFCNT, GLOBALSCALER = 0x00, 0x01, 0x02, 0x0B
IHOLD_IRUN, TPOWERDOWN, TPWMTHRS, TCOOLTHRS, SGTHRS = 0x10, 0x11, 0x13, 0x14, 0x40
CHOPCONF, COOLCONF, DRV_STATUS = 0x6C, 0x6D, 0x6F
SQRT2 = math.sqrt(2.0)
HIGH_V, LOW_V = {"tmc2208": 0.325, "tmc2209": 0.325, "tmc2130": 0.32, "tmc5160": 0.325}, 0.18
"""Full-scale voltage at the sense resistor, V, for vsense 0 and 1."""
SERIES_OHM = 0.02
"""Resistance inside the driver in series with its sense resistor, ohm; not for TMC5160."""
CLOCK = 12e6
"""Internal clock of the drivers, Hz, in which TSTEP counts the time of a 256th of a full step."""
SEEN = 0.7
"""Share of the speed of a move from which a stall counts."""
STEPS = 32
"""Steps of the current."""


@dataclass(frozen=True, slots=True)
class Setting:
    """The value of a register, and whether the driver gives it back."""

    register: int
    value: int
    readable: bool


@dataclass(frozen=True, slots=True)
class Currents:
    """Settings of the currents: global scaler (0 for none), vsense, and scales of run and hold."""

    scaler: int
    sensitive: bool
    run: int
    hold: int


class CurrentOutOfRange(ValueError):
    """A current that the driver cannot set; its text names the range."""


def currents(driver: TrinamicDriver) -> Currents:
    """Return the settings for the currents of a driver.

    Raises:
        CurrentOutOfRange: The driver cannot give them.
    """
    run = driver.run_current
    hold = run if driver.hold_current is None else driver.hold_current
    if driver.kind == "tmc5160":
        full = HIGH_V[driver.kind] / driver.resistor / SQRT2
        most, least = full, full * 32 / 256
        if not least <= run <= most:
            raise CurrentOutOfRange(f"{least:.2g} to {most:.2g} A")
        scaler = min(round(256 * run / full), 255)
        return Currents(scaler, False, STEPS - 1, _scale(hold / run))
    resistor = driver.resistor + SERIES_OHM
    high, low = (volt / resistor / SQRT2 for volt in (HIGH_V[driver.kind], LOW_V))
    if not high / STEPS / 2 <= run <= high:
        raise CurrentOutOfRange(f"{low / STEPS:.2g} to {high:.2g} A")
    # The lower voltage is finer and wastes less heat.
    sensitive = max(run, hold) <= low
    full = low if sensitive else high
    return Currents(0, sensitive, _scale(run / full), _scale(hold / full))


def _scale(share: float) -> int:
    return min(max(round(STEPS * share) - 1, 0), STEPS - 1)


def settings(driver: TrinamicDriver) -> Iterator[Setting]:
    """Yield the registers of a driver in the order in which they are written.

    Raises:
        CurrentOutOfRange: The driver cannot give the currents.
    """
    amps = currents(driver)
    stall = driver.stallguard
    yield Setting(GCONF, general(driver, silent=driver.stealthchop), True)
    if amps.scaler:
        yield Setting(GLOBALSCALER, amps.scaler, False)
    yield Setting(IHOLD_IRUN, amps.hold | amps.run << 8 | 6 << 16, False)
    yield Setting(TPOWERDOWN, 20, False)
    resolution = 8 - driver.microsteps.bit_length() + 1
    # Off time 3, hysteresis 5 and 2, blank time 2: the data sheets' start values.
    chop = 3 | 4 << 4 | 1 << 7 | 2 << 15 | resolution << 24 | 1 << 28
    yield Setting(CHOPCONF, chop | (1 << 17 if amps.sensitive else 0), True)
    yield Setting(TPWMTHRS, 0, False)
    if stall is not None:
        # DIAG tells a stall only while the axis homes (stall_settings).
        yield Setting(TCOOLTHRS, 0, False)
        if driver.has_uart:
            yield Setting(SGTHRS, stall, False)
        else:
            yield Setting(COOLCONF, (stall & 0x7F) << 16, False)


def general(driver: TrinamicDriver, *, silent: bool) -> int:
    """Return GCONF in the silent mode (stealthChop) or in the other one (spreadCycle)."""
    if driver.has_uart:
        # Currents by register instead of a voltage; microsteps by register; the UART stays on.
        return 1 << 6 | 1 << 7 | (0 if silent else 1 << 2)
    value = 1 << 2 if silent else 0
    if driver.stallguard is not None:
        value |= 1 << 8 | 1 << 13
    return value


def stall_settings(driver: TrinamicDriver, speed: float) -> list[Setting]:
    """Return the registers for a move that ends at a hard stop.

    StallGuard4 (tmc2209) needs stealthChop, StallGuard2 (tmc2130, tmc5160) needs spreadCycle. A
    slow motor has no back EMF that could be measured, so a stall counts only near full speed.

    Args:
        driver: The driver.
        speed: Speed of the move, steps/s.
    """
    ticks = CLOCK / (SEEN * speed * 256 / driver.microsteps)
    return [
        Setting(GCONF, general(driver, silent=driver.has_uart), True),
        Setting(TCOOLTHRS, min(round(ticks), 0xFFFFF), False),
    ]


def motion_settings(driver: TrinamicDriver) -> list[Setting]:
    """Return the registers that end the measurement of stalls."""
    return [
        Setting(TCOOLTHRS, 0, False),
        Setting(GCONF, general(driver, silent=driver.stealthchop), True),
    ]


UART_FAULTS = {
    1: "it is too hot",
    2: "short circuit to ground at coil A",
    3: "short circuit to ground at coil B",
    4: "short circuit at coil A",
    5: "short circuit at coil B",
}
SPI_FAULTS = {
    25: "it is too hot",
    27: "short circuit to ground at coil A",
    28: "short circuit to ground at coil B",
    12: "short circuit at coil A",
    13: "short circuit at coil B",
}
"""Faults by their bits in DRV_STATUS."""


def reset_of(value: int) -> str:
    """Return the fault in GSTAT, "" if there is none."""
    if value & 1:
        return "it was reset, because its supply failed, so its settings are lost"
    return "its charge pump has too low a voltage" if value & 4 else ""


def fault_of(driver: TrinamicDriver, status: int) -> str:
    """Return the fault in DRV_STATUS, "" if there is none."""
    known = UART_FAULTS if driver.has_uart else SPI_FAULTS
    if driver.kind == "tmc2130":
        known = {bit: text for bit, text in known.items() if bit > 20}
    return "; ".join(text for bit, text in known.items() if status >> bit & 1)

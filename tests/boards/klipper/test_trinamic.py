"""Motor drivers by Trinamic: datagrams, currents, settings that are read back, faults."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.boards.klipper.trinamic import (
    CHOPCONF,
    COOLCONF,
    DRV_STATUS,
    GCONF,
    GLOBALSCALER,
    IHOLD_IRUN,
    SGTHRS,
    TCOOLTHRS,
    CurrentOutOfRange,
    crc8,
    currents,
    from_bits,
    to_bits,
    uart_read,
    uart_write,
)
from cnc.machine.klipper import TrinamicDriver
from cnc.machine.models import Machine
from cnc.model.diagnostics import BoardError, MachineFileError
from cnc.simulators.klipper.devices import DriverModel
from cnc.simulators.klipper.ports import simulator_for
from tests.support.boards.gantry_board import gantry
from tests.support.boards.klipper_rig import (
    after,
    board,
    check_pulses,
    last_step,
    machine,
    pins,
    place,
    played,
    with_board,
)
from tests.support.soak import share


def test_datagrams_of_the_data_sheet() -> None:
    """The read of IFCNT, as printed by many programs: 05 00 02 8F; here the high bits are set."""
    assert crc8(bytes((0x05, 0x00, 0x02))) == 0x8F
    assert uart_read(0, 2)[:3] == bytes((0xF5, 0x00, 0x02))
    data = uart_write(3, 0x10, 0x01020304)
    assert data[:7] == bytes((0xF5, 3, 0x90, 1, 2, 3, 4))
    # Start bit 0, then 1010 1: by this beginning the firmware tells a sync byte.
    assert to_bits(data)[0] & 0x3F == 0b101010


@given(st.binary(max_size=20))
def test_crc_is_that_of_polynomial_division(data: bytes) -> None:
    """Divide the bits, lowest of each byte first, by x^8 + x^2 + x + 1."""
    bits = [byte >> k & 1 for byte in data for k in range(8)] + [0] * 8
    for at in range(len(bits) - 8):
        if bits[at]:
            for k in (0, 6, 7, 8):
                bits[at + k] ^= 1
    assert crc8(data) == int("".join(map(str, bits[-8:])), 2)


@given(st.binary(min_size=1, max_size=20))
def test_bits_survive(data: bytes) -> None:
    found = from_bits(to_bits(data))
    assert found is not None
    assert found[: len(data)] == data


def driver(kind: str, **keys: object) -> TrinamicDriver:
    keys = {"uart": "gpio26", **keys} if kind in ("tmc2208", "tmc2209") else keys
    connection = (
        {"uart": "gpio26"}
        if kind in ("tmc2208", "tmc2209")
        else {"select": "gpio27", "spi_bus": "spi0c"}
    )
    return TrinamicDriver.model_validate({"kind": kind, "run_current": 0.8, **connection, **keys})


@pytest.mark.parametrize("kind", ["tmc2208", "tmc2209", "tmc2130", "tmc5160"])
@pytest.mark.parametrize("amps", [0.45, 0.8, 1.2])
def test_currents_follow_the_data_sheet(kind: str, amps: float) -> None:
    """I = (CS + 1) / 32 * V / (R + 0.02) / sqrt 2; TMC5160: scaler / 256, without the 0.02 ohm."""
    known = driver(kind, run_current=amps, hold_current=amps / 2)
    found = currents(known)
    if kind == "tmc5160":
        full = 0.325 / 0.075 / math.sqrt(2) * found.scaler / 256
        step = full / 32 + full / found.scaler
    else:
        volt = 0.18 if found.sensitive else (0.32 if kind == "tmc2130" else 0.325)
        full = volt / 0.13 / math.sqrt(2)
        step = full / 32
    assert full * (found.run + 1) / 32 == pytest.approx(amps, abs=step)
    assert full * (found.hold + 1) / 32 == pytest.approx(amps / 2, abs=step)


@pytest.mark.parametrize(("kind", "amps"), [("tmc2209", 3.0), ("tmc2209", 0.01), ("tmc5160", 0.3)])
def test_impossible_currents_are_refused(kind: str, amps: float) -> None:
    with pytest.raises(CurrentOutOfRange):
        currents(driver(kind, run_current=amps))


def with_driver(kind: str, **keys: object) -> Machine:
    known = machine()
    x = pins(known).x
    assert x is not None
    return machine(x=x.model_copy(update={"driver": (driver(kind, **keys),)}))


def model(known: Machine, simulator: object, letter: str = "x", number: int = 0) -> DriverModel:
    axis = pins(known).axis(letter)
    assert axis is not None
    assert axis.driver is not None
    known_driver = axis.driver[number]
    if known_driver.uart is not None:
        return simulator.uarts[simulator.pin(known_driver.uart)].drivers[known_driver.address]  # type: ignore[attr-defined]
    return simulator.spi[simulator.pin(str(known_driver.select))]  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", ["tmc2208", "tmc2209", "tmc2130", "tmc5160"])
def test_settings_reach_the_driver(kind: str, tmp_path: Path) -> None:
    stall = {} if kind == "tmc2208" else {"stallguard": 20}
    known = with_driver(kind, microsteps=64, stealthchop=True, hold_current=0.4, **stall)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 F600\nM2\n")
    report, simulator = played(tmp_path / "p.ngc", tmp_path, known)
    assert report.ok, report.faults
    registers = model(known, simulator).registers
    amps = currents(driver(kind, hold_current=0.4))
    assert registers[IHOLD_IRUN] & 0x1F == amps.hold
    assert registers[IHOLD_IRUN] >> 8 & 0x1F == amps.run
    # MRES: 8 is the full step, 0 is 256 microsteps.
    assert 256 >> (registers[CHOPCONF] >> 24 & 15) == 64
    assert registers[CHOPCONF] & 15 > 0
    spread = registers[GCONF] >> 2 & 1
    assert spread == (0 if kind in ("tmc2208", "tmc2209") else 1)
    if kind == "tmc5160":
        assert registers[GLOBALSCALER] == amps.scaler
    if kind == "tmc2209":
        assert registers[SGTHRS] == 20
    elif stall:
        assert registers[COOLCONF] >> 16 & 0x7F == 20
    if stall:
        assert registers[TCOOLTHRS] == 0, "a stall counts only in homing"


@pytest.mark.parametrize("kind", ["tmc2209", "tmc5160"])
@pytest.mark.parametrize("fault", ["no power", "ignored register"])
def test_drivers_that_do_not_follow_are_refused(kind: str, fault: str) -> None:
    known = with_driver(kind)
    simulator = simulator_for(known)
    each = model(known, simulator)
    if fault == "no power":
        each.powered = False
    else:
        each.ignored = {CHOPCONF}
    with pytest.raises(BoardError) as caught, board(known, simulator):
        pass
    assert caught.value.diagnostic.code == "motor-driver"
    assert "of X" in caught.value.diagnostic.message


@pytest.mark.parametrize(("kind", "bit"), [("tmc2209", 2), ("tmc5160", 27), ("tmc2130", 25)])
def test_faults_of_drivers_refuse_the_start(kind: str, bit: int, tmp_path: Path) -> None:
    known = with_driver(kind)
    simulator = simulator_for(known)
    model(known, simulator).registers[DRV_STATUS] = 1 << bit
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X2 F600\nM2\n")
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert [each.diagnostic.code for each in report.faults] == ["motor-driver"]
    assert not len(simulator.edges(str(pins(known).x.step[0]))[0])  # type: ignore[union-attr]


def test_drivers_share_a_uart_by_their_addresses() -> None:
    known = machine()
    x, y = pins(known).x, pins(known).y
    assert x is not None
    assert y is not None
    known = machine(
        x=x.model_copy(update={"driver": (driver("tmc2209", address=0),)}),
        y=y.model_copy(update={"driver": (driver("tmc2209", address=2, microsteps=8),)}),
    )
    with board(known) as (_, simulator):
        wire = simulator.uarts[simulator.pin("gpio26")]
    assert [wire.drivers[k].registers[CHOPCONF] >> 24 & 15 for k in (0, 2)] == [4, 5]


def test_current_out_of_range_names_the_machine_file() -> None:
    with pytest.raises(MachineFileError) as caught, board(with_driver("tmc2209", run_current=5.0)):
        pass
    assert "5 A" in caught.value.diagnostic.message


@pytest.mark.parametrize(
    ("kind", "event", "text"),
    [
        ("tmc2209", "hot", "it is too hot"),
        *share(
            [
                ("tmc5160", "short", "short circuit to ground at coil A"),
                ("tmc2209", "reset", "its settings are lost"),
                ("tmc2130", "reset", "its settings are lost"),
                ("tmc2209", "off", "does not answer any more"),
            ],
            [],
        ),
        ("tmc5160", "off", "does not answer any more"),
    ],
)
def test_fault_of_a_driver_in_motion_stops_the_machine(
    kind: str, event: str, text: str, tmp_path: Path
) -> None:
    known = with_driver(kind)
    simulator = simulator_for(known)
    each, happened = model(known, simulator), []

    def happen() -> None:
        happened.append(simulator.now)
        if event == "reset":
            each.reset()
        elif event == "off":
            each.powered = False
        else:
            each.registers[DRV_STATUS] |= 1 << {"hot": 1, "short": 27}[event]

    after(simulator, 0.5, happen)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X30 Y20 F900\nM2\n")
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    [fault] = report.faults
    assert fault.diagnostic.code == "motor-driver"
    assert text in fault.diagnostic.message
    assert "of X" in fault.diagnostic.message
    assert "the machine is at X" in fault.diagnostic.message
    made = place(known, simulator)
    assert 0 < made[0] < 12_000
    at = report.end_position.values()
    assert [round(v * s) for v, s in zip(at, known.steps_per_mm, strict=True)] == made
    assert last_step(simulator) - happened[0] <= (2.0 if event == "off" else 0.3)
    simulator.advance(simulator.now + 1.0)
    assert place(known, simulator) == made


def test_drivers_in_order_disturb_nothing(tmp_path: Path) -> None:
    """While a program runs, each driver of each axis is asked again and again."""
    known = machine()
    axes = {}
    for address, letter in enumerate(known.axes):
        axis = pins(known).axis(letter)
        assert axis is not None
        axes[str(letter)] = axis.model_copy(
            update={"driver": (driver("tmc2209", address=address, uart="gpio29"),)}
        )
    known = machine(**axes)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X30 Y20 F900\nG1 Z2\nM2\n")
    asked: list[int] = []
    simulator = simulator_for(known)
    wire = simulator.uarts[simulator.pin("gpio29")]
    send = wire.send

    def noted(bits: bytes, size: int) -> bytes:
        data = from_bits(bits)
        assert data is not None
        asked.append(data[2])
        return send(bits, size)

    wire.send = noted  # type: ignore[method-assign]
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert report.ok, report.faults
    check_pulses(known, simulator, tmp_path, 7.0)
    assert asked.count(DRV_STATUS) > 10


def test_both_drivers_of_a_gantry_are_configured_and_watched(tmp_path: Path) -> None:
    known = gantry(0.0, letter="x")
    x = pins(with_board(known)).x
    assert x is not None
    both = x.model_copy(
        update={
            "step": ("gpio22", "gpio23"),
            "direction": ("gpio24", "gpio25"),
            "endstop": None,
            "driver": (
                driver("tmc2209", address=0, microsteps=8),
                driver("tmc2209", address=1, microsteps=8),
            ),
        }
    )
    axes = {name: axis.model_copy(update={"homing": None}) for name, axis in known.axes.items()}
    known = with_board(known.model_copy(update={"axes": axes}), x=both)
    simulator = simulator_for(known)
    second = model(known, simulator, "x", 1)
    after(simulator, 0.3, second.reset)
    (tmp_path / "p.ngc").write_text("G21 G90\nG1 X8 F600\nM2\n")
    report, _ = played(tmp_path / "p.ngc", tmp_path, known, simulator)
    assert second.registers[DRV_STATUS]
    [fault] = report.faults
    assert "the tmc2209 of motor 2 of X" in fault.diagnostic.message
    broken = simulator_for(known)
    model(known, broken, "x", 1).ignored = {CHOPCONF}
    with pytest.raises(BoardError) as caught, board(known, broken):
        pass
    assert "motor 2 of X" in caught.value.diagnostic.message

"""The accelerometer of a Klipper board: its samples, its faults, and the modes of a machine."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.boards.klipper.accelerometer import BLOCK, RATES, SCALE, raw_samples
from cnc.machine.klipper import Accelerometer
from cnc.machine.load import load_machine
from cnc.measure.procedures import Scale, Shake
from cnc.measure.ringing import shaken
from cnc.model.diagnostics import BoardError, MachineFileError
from cnc.model.operator_control import Control
from cnc.operate.jogging import jog
from cnc.simulators.klipper.accelerometer import (
    OWN_CLOCK,
    AccelerometerModel,
    G,
    Mode,
    add_accelerometer,
)
from cnc.simulators.klipper.ports import KlipperSimulatorPort, simulator_for
from tests.support.boards.klipper_rig import connected, machine
from tests.support.soak import share

SENSOR = Accelerometer(select="gpio29", spi_bus="spi1c")


class Bench:
    """A board in virtual time with a sensor at a tool that rings."""

    def __init__(self, modes, **table):
        sensor = SENSOR.model_copy(update=table)
        self.known = machine("rp2040", accelerometer=sensor)
        self.simulator = simulator_for(self.known)
        self.model = add_accelerometer(self.simulator, self.known, modes)
        port = KlipperSimulatorPort(self.simulator)
        self.board = connected(self.known, self.simulator, port)

    @property
    def sensor(self):
        return self.board.accelerometer

    def wait(self, seconds):
        supervisor = self.board._supervisor
        supervisor.connection.wait(seconds, supervisor.pump)

    def shake(self, step):
        """Carry out a step as a session does, in virtual time."""
        column = tuple(self.known.axes).index(step.axis)
        here = np.zeros(len(self.known.axes))
        self.sensor.begin()

        def rest():
            self.sensor.mark()
            self.wait(step.rest)
            self.sensor.mark()

        rest()
        for way in step.ways:
            there = here.copy()
            there[column] += way
            for begin, end in ((here, there), (there, here)):
                jog(self.board, self.known, begin, end, 80.0, control=Control())
                rest()
        return self.sensor.end()

    def measured(self, letter="x"):
        axis = self.known.axes[letter]
        procedure = shaken(Scale(letter, axis.steps_per_mm, 0.0, (-100.0, 100.0)))
        step = next(procedure)
        assert isinstance(step, Shake)
        try:
            procedure.send(self.shake(step))
        except StopIteration as end:
            return end.value


@given(st.lists(st.tuples(*[st.integers(-4096, 4095)] * 3), min_size=1, max_size=40))
def test_samples_are_unpacked_as_the_firmware_packs_them(samples):
    """Written from the firmware's layout: low bytes, then the high bits of x and z, of y and z."""
    packed = bytearray()
    for x, y, z in samples:
        x, y, z = (value & 0x1FFF for value in (x, y, z))
        high_x, high_y, high_z = x >> 8, y >> 8, z >> 8
        packed += bytes((x & 255, y & 255, z & 255))
        packed += bytes((high_x | (high_z << 5) & 0xE0, high_y | (high_z << 2) & 0x60))
    data = np.frombuffer(bytes(packed), np.uint8).reshape(-1, 5)
    assert raw_samples(data).tolist() == [list(each) for each in samples]


@pytest.mark.parametrize("seed", [301, 302, 303][: share(3, 1)])
def test_two_modes_of_an_axis_are_found_to_one_per_cent(seed):
    rng = np.random.default_rng(seed)
    first = rng.uniform(20.0, 45.0)
    wanted = [first, rng.uniform(1.5, 2.0) * first]
    modes = [Mode(f, rng.uniform(0.02, 0.06), 0.5) for f in wanted]
    found = Bench({"x": modes}).measured()
    assert [mode.frequency for mode in found.modes] == pytest.approx(wanted, rel=0.01)
    assert [mode.damping for mode in found.modes] == pytest.approx(
        [mode.damping for mode in modes], rel=0.3
    )


def test_modes_of_38_and_61_hz_are_found_along_the_axis_of_the_map():
    """The sensor lies on its side: its x is along Y of the machine."""
    bench = Bench({"y": (Mode(38.0, 0.05, 0.6), Mode(61.0, 0.04, 0.4))}, axes_map=("y", "-x", "z"))
    found = bench.measured("y")
    assert [mode.frequency for mode in found.modes] == pytest.approx([38.0, 61.0], rel=0.01)
    assert {mode.axis for mode in found.modes} == {"y"}


@pytest.mark.parametrize("rate", sorted(RATES))
def test_the_rate_is_that_of_the_sensors_own_clock(rate):
    bench = Bench({}, rate=rate)
    for _ in range(2):
        bench.sensor.begin()
        bench.wait(2.0)
        record = bench.sensor.end()
        assert record.rate == pytest.approx(rate * OWN_CLOCK, rel=2e-3)
        assert abs(len(record.columns["z"]) - 2.0 * rate * OWN_CLOCK) < 0.05 * rate
        assert record.columns["z"].mean() == pytest.approx(G, abs=SCALE)
        assert abs(record.columns["x"].mean()) < SCALE


def refused(act):
    with pytest.raises(BoardError) as fault:
        act()
    assert fault.value.diagnostic.code == "accelerometer-fault"
    return fault.value.diagnostic.message


def test_a_sensor_that_does_not_answer_is_named():
    bench = Bench({})
    bench.model.powered = False
    assert "answers 0x00 instead of 0xe5" in refused(bench.sensor.begin)


def test_a_sensor_that_takes_no_settings_is_named():
    bench = Bench({})
    bench.model.registers = dict(bench.model.registers)
    type(bench.model).transfer, before = (
        lambda self, data: before(self, data) if data[0] & 0x80 else bytes(2),
        AccelerometerModel.transfer,
    )
    try:
        assert "register" in refused(bench.sensor.begin)
    finally:
        type(bench.model).transfer = before


def test_one_sample_that_is_read_wrongly_is_replaced_and_many_are_a_fault():
    bench = Bench({})
    bench.model.wrong = frozenset((100,))
    bench.sensor.begin()
    bench.wait(0.5)
    record = bench.sensor.end()
    assert abs(record.columns["x"]).max() < 10 * SCALE
    bench = Bench({})
    bench.model.wrong = frozenset(range(100, 500))
    bench.sensor.begin()
    bench.wait(0.5)
    assert "samples are not readable" in refused(bench.sensor.end)


def test_lost_samples_are_a_fault():
    bench = Bench({})
    bench.sensor.begin()
    bench.wait(0.5)
    del bench.sensor._blocks[7]
    assert "lost on the cable" in refused(bench.sensor.end)
    # The board goes on, and so does the next record.
    bench.sensor.begin()
    bench.wait(0.1)
    assert len(bench.sensor.end().columns["x"]) % BLOCK == 0


TABLE = """\
[axes.x]
steps_per_mm = 100
max_velocity = 100
max_acceleration = 500
max_jerk = 10000
[board]
kind = "klipper"
[board.klipper]
mcu = "rp2040"
[board.klipper.x]
step = "gpio2"
direction = "gpio3"
[board.klipper.accelerometer]
"""


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ('select = "gpio2"', "used by board.klipper.x.step already"),
        ('select = "gpio1"\naxes_map = ["x", "y", "y"]', "must have x, y and z once"),
        ('select = "gpio1"\naxes_map = ["x", "y"]', "axes_map"),
        ('select = "gpio1"\nrate = 1000', "rate"),
        ('spi_bus = "spi1a"', "select"),
    ],
)
def test_a_wrong_table_is_an_error_in_its_line(tmp_path, keys, message):
    file = tmp_path / "mill.toml"
    file.write_text(f"{TABLE}{keys}\n")
    with pytest.raises(MachineFileError) as fault:
        load_machine(file)
    assert message in fault.value.diagnostic.message
    assert fault.value.diagnostic.line > 0

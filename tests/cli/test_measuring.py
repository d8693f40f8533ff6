"""The commands cncrun measure: typed readings in, keys of the machine file out."""

import io
import math
import signal

import numpy as np
import pytest

from cnc.machine.load import load_machine
from tests.support.boards.probe_bench import Part, ProbeBench, Slab
from tests.support.faulty_machine import FaultyMachine

AXIS = """\
[axes.{letter}]
steps_per_mm = 400.0
max_velocity = 400.0
max_acceleration = 8000.0
max_jerk = 400000.0
travel = [-300, 300]

"""
BACKLASH = "1.0\n0.55\n1.0\n0.551\nzero\n1.0\n0.549\n1.001\n"


@pytest.fixture
def mill(tmp_path):
    file = tmp_path / "mill.toml"
    tables = "".join(AXIS.format(letter=letter) for letter in "xyz")
    file.write_text(f'[machine]\nname = "Mill"\n\n{tables}[board]\nkind = "loopback"\n')
    return file


@pytest.fixture
def typed(monkeypatch):
    return lambda text: monkeypatch.setattr("sys.stdin", io.StringIO(text))


def test_backlash_is_measured_shown_and_written(cncrun, mill, typed):
    before = mill.read_text()
    typed(BACKLASH)
    code, out, err = cncrun("measure", "backlash", "X", "--yes", "--machine", str(mill))
    assert code == 0
    assert "backlash of X: 0.05 mm\n" in out
    assert "home the machine before it runs again" in out
    assert "a number in mm is wanted" in err
    assert load_machine(mill).axes["x"].backlash == pytest.approx(0.05)
    changed = [line for line in mill.read_text().splitlines() if line not in before.splitlines()]
    assert len(changed) == 1
    assert changed[0].startswith("backlash = 0.05  # measured 20")
    # Measured again, the old value does not hide the play.
    typed(BACKLASH)
    assert cncrun("measure", "backlash", "x", "--yes", "--machine", str(mill))[0] == 0
    assert load_machine(mill).axes["x"].backlash == pytest.approx(0.05)


def test_a_machine_file_that_is_a_link_stays_one(cncrun, mill, typed, tmp_path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    link = folder / "linked.toml"
    link.symlink_to(mill)
    typed(BACKLASH)
    assert cncrun("measure", "backlash", "X", "--yes", "--machine", str(link))[0] == 0
    assert link.is_symlink()
    assert load_machine(mill).axes["x"].backlash == pytest.approx(0.05)


@pytest.mark.parametrize("words", [("measure", "backlash", "X", "--unhomed"), ("mdi",)])
def test_ctrl_c_ends_a_command_that_waits_for_a_line(cncrun, monkeypatch, words):
    """The machine rests: the stop of a motion would wait for the line."""

    class Waiting(io.StringIO):
        def readline(self, *_):
            signal.raise_signal(signal.SIGINT)
            return "1.0\n"

    monkeypatch.setattr("sys.stdin", Waiting())
    code, _, err = cncrun(*words)
    assert code == 130
    assert err.endswith("stopped by the operator; the machine is at rest\n")


def test_without_a_terminal_nothing_is_written_unasked(cncrun, mill, typed):
    before = mill.read_text()
    typed(BACKLASH)
    code, out, err = cncrun("measure", "backlash", "X", "--machine", str(mill))
    assert code == 2
    assert "needs-yes" in err
    assert "backlash of X: 0.05 mm\n" in out
    assert mill.read_text() == before


def test_errors_of_a_screw_become_a_table_beside_the_machine_file(cncrun, mill, typed):
    typed("".join(f"{7.0 + 1.0002 * place}\n" for place in range(-240, 300, 60)))
    options = ("--first", "-240", "--last", "240", "--places", "9", "--yes", "--machine", str(mill))
    code, out, _ = cncrun("measure", "pitch", "Y", *options)
    assert code == 0
    assert "errors of Y: up to 0.096 mm" in out
    table = load_machine(mill).axes["y"].error_table
    assert [row.place for row in table] == [-300, *range(-240, 300, 60), 300]
    assert [row.forward for row in table[1:-1]] == pytest.approx(
        [0.012 * k for k in range(9)], abs=1e-4
    )
    assert sorted(file.name for file in mill.parent.iterdir()) == ["mill-y-errors.csv", "mill.toml"]


def test_the_angle_of_two_axes_is_written_with_its_unit(cncrun, mill, typed):
    """The legs lean by 0.1 mm over 100 mm against Y; the plunger points away from it."""
    typed("5\n5\n3\n2.9\n" * 2)
    options = ("--lengths", "100", "100", "--yes", "--machine", str(mill))
    code, out, _ = cncrun("measure", "square", "XY", *options)
    assert (code, "angle between X and Y: 90.0573 deg\n" in out) == (0, True)
    assert load_machine(mill).squareness.xy == "0.0573 deg"


def test_a_shipped_machine_is_not_changed(cncrun, typed):
    typed(BACKLASH)
    code, out, _ = cncrun("measure", "backlash", "X", "--yes", "--unhomed")
    assert code == 0
    assert "write into a machine file of your own:\n  axes.x.backlash = 0.05\n" in out


def test_a_board_that_plans_by_itself_gets_no_keys(cncrun, mill, typed):
    mill.write_text(mill.read_text().replace("loopback", "grbl"))
    before = mill.read_text()
    typed(BACKLASH)
    options = ("--yes", "--unhomed", "--board", "loopback", "--machine", str(mill))
    code, out, _ = cncrun("measure", "backlash", "X", *options)
    assert code == 0
    assert "nothing was written: the board grbl plans by itself" in out
    assert mill.read_text() == before


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("backlash", "Q"), "measure-axis"),
        (("square", "XX", "--lengths", "50", "50"), "measure-axis"),
        (("pitch", "X", "--first", "0", "--last", "100"), "measure-option"),
        (("backlash", "X", "--reverse", "nan"), "measure-option"),
        (("backlash", "X"), "reading-missing"),
    ],
)
def test_what_cannot_be_measured_is_refused(cncrun, mill, typed, words, code):
    typed("")
    exit_code, _, err = cncrun("measure", *words, "--machine", str(mill))
    assert exit_code == 2
    assert f"{code}: " in err


def test_modes_are_found_in_a_record_and_written(cncrun, mill, tmp_path):
    """A frame that is struck once a second; an axis that hears nothing is refused by name."""
    t = np.arange(0.0, 4.0, 0.001)
    after = t % 1.0
    waves = [
        weight
        * np.exp(-d * 2 * np.pi * f * after)
        * np.sin(2 * np.pi * f * (1 - d * d) ** 0.5 * after)
        for f, d, weight in ((38.0, 0.05, 1.0), (61.0, 0.04, 0.7))
    ]
    file = tmp_path / "record.csv"
    rows = [f"{time:.4f},{value:.6f}" for time, value in zip(t, waves[0] + waves[1], strict=True)]
    file.write_text("time,ax\n" + "\n".join(rows) + "\n")
    code, out, _ = cncrun("measure", "ringing", str(file))
    assert code == 0
    shown = [line.split() for line in out.splitlines() if line.startswith("X ")]
    assert [float(words[1]) for words in shown] == pytest.approx([38.0, 61.0], rel=0.01)
    assert "write into a machine file of your own:\n  vibration.x = [{frequency = 3" in out
    before = mill.read_text()
    code, out, _ = cncrun("measure", "ringing", str(file), "--machine", str(mill), "--yes")
    assert code == 0
    assert "home the machine" not in out
    modes = load_machine(mill).vibration["x"]
    assert [mode.frequency for mode in modes] == pytest.approx([38.0, 61.0], rel=0.01)
    assert [mode.damping for mode in modes] == pytest.approx([0.05, 0.04], rel=0.1)
    assert mill.read_text().startswith(before)
    assert "record.csv, 1000 samples a second" in mill.read_text()
    file.write_text("time,ax\n" + "\n".join(f"{time:.4f},1.0" for time in t) + "\n")
    code, _, err = cncrun("measure", "ringing", str(file))
    assert code == 2
    assert err.startswith("record-form: ")


SENSOR = """[board.klipper.x]
step = "gpio11"
direction = "!gpio10"
[board.klipper.y]
step = "gpio6"
direction = "!gpio5"
[board.klipper.z]
step = "gpio19"
direction = "!gpio28"
[board.klipper.accelerometer]
select = "gpio1"
spi_bus = "spi1c"
"""


@pytest.mark.soak
def test_an_axis_is_shaken_and_the_accelerometer_shows_the_modes(cncrun, mill):
    """In real time, so a computer that is too busy is refused by the board."""
    text = mill.read_text().replace("loopback", "klipper-sim").replace("400000.0", "100000.0")
    mill.write_text(
        text.replace("8000.0", "2000.0").replace("= 400.0\nmax_v", "= 100.0\nmax_v") + SENSOR
    )
    words = ("ringing", "Y", "--accelerometer", "--machine", str(mill))
    code, out, err = cncrun("measure", *words)
    assert code == 0, err
    shown = [line.split() for line in out.splitlines() if line.startswith("Y ")]
    assert [float(words[1]) for words in shown] == pytest.approx([38.0, 61.0], rel=0.01)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("ringing", "X", "--accelerometer"), "no-accelerometer"),
        (("ringing", "Q", "--accelerometer"), "measure-axis"),
        (("ringing", "record.csv", "--unhomed"), "measure-option"),
        (("ringing", "record.csv", "--board", "loopback"), "measure-option"),
    ],
)
def test_what_an_accelerometer_cannot_do_is_refused(cncrun, mill, words, code):
    machine = ("--machine", str(mill)) if "--accelerometer" in words else ()
    exit_code, _, err = cncrun("measure", *words, *machine)
    assert exit_code == 2
    assert f"{code}: " in err


def test_limits_are_rehearsed_on_a_simulated_board_and_not_written(cncrun, mill):
    """A simulated motor loses no step, so its limits say nothing about the machine."""
    mill.write_text(mill.read_text().replace("[-300, 300]", "[-60, 60]"))
    before = mill.read_text()
    words = ("limits", "Y", "--most", "0.6", "--yes", "--machine", str(mill))
    code, out, err = cncrun("measure", *words)
    assert code == 0
    assert "velocity            200 mm/s      +0.0000 mm  right\n" in out
    assert out.endswith("the board is simulated, so the limits of the machine file stay\n")
    assert "200 mm/s, 4000 mm/s^2, 2e+05 mm/s^3\n" in err
    assert mill.read_text() == before


def test_ctrl_c_brings_the_axis_to_rest_while_its_limits_are_raised(cncrun, mill, monkeypatch):
    monkeypatch.setattr(
        "cnc.operate.measuring.strokes", lambda _: signal.raise_signal(signal.SIGINT)
    )
    code, out, err = cncrun("measure", "limits", "X", "--machine", str(mill))
    assert (code, out) == (130, "")
    ending = "stopped by the operator; the position of the axis that was homing is not known\n"
    assert err.endswith(ending)


@pytest.mark.parametrize("words", [("--feed", "100"), ("--unhomed",)])
def test_limits_refuse_the_options_of_a_gauge(cncrun, mill, words):
    """They would have no effect: the axis homes, and its speed is what is measured."""
    code, _, err = cncrun("measure", "limits", "X", *words, "--machine", str(mill))
    assert code == 2
    assert words[0] in err


def test_limits_on_a_board_that_plans_by_itself_are_refused(cncrun, mill):
    words = ("limits", "X", "--board", "grbl-sim", "--machine", str(mill))
    code, _, err = cncrun("measure", *words)
    assert code == 2
    assert "measure-board" in err


BENCH_STEPS = 400.0
"""Steps per mm of the machine file."""
BALL = 1.0
WAVE = 0.03
QUICK = ("--contact-feed", "400")
"""A contact of this board is exact at each feed; slow contacts are in the test of a screw."""


@pytest.fixture
def bench(monkeypatch):
    """Return a function that puts a faulty machine with a probe behind the next command."""

    def put(slabs, start, **errors):
        part = Part(slabs, BALL, 0.002, 4)

        class Bench(ProbeBench):
            @classmethod
            def for_operator(cls, machine, _):
                return cls(machine, start, FaultyMachine(**errors), part)

        monkeypatch.setattr("cnc.boards.registry.board_factory", lambda _: Bench)
        return part

    return put


class Shifted:
    """A slab at another place."""

    def __init__(self, slab, by):
        self.slab, self.by = slab, by

    def distance(self, places):
        return self.slab.distance(places - self.by)


def test_backlash_is_measured_with_the_probe(cncrun, mill, bench):
    """A face of 45 degrees lies 6 mm from the probe in Y. Other errors are in the machine too."""
    mill.write_text(mill.read_text().replace('"Mill"', '"Mill"\nsquareness = { xy = "0.2 deg" }'))
    away = 6.0 * math.cos(math.radians(45.0))
    slab = Slab((-90.0, away, -90.0), (90.0, away + 30.0, 90.0), 45.0)
    bench([slab], (0.0, 0.0, 0.0), backlash={"x": 0.05, "y": 0.03}, xy=0.2)
    words = ("backlash", "X", "--probe", "--touch", "Y+", *QUICK, "--yes", "--machine", str(mill))
    code, out, err = cncrun("measure", *words)
    assert code == 0, err
    axis = load_machine(mill).axes["x"]
    assert axis.backlash == pytest.approx(0.05, abs=1.0 / BENCH_STEPS)
    line = next(text for text in mill.read_text().splitlines() if "backlash" in text)
    assert "# measured 20" in line
    assert "3 reversals at a slanted face, contacts within 0.0" in line
    assert "before" in out


def test_errors_of_a_screw_are_measured_with_the_probe(cncrun, mill, bench):
    """The faces of a step gauge, from 20 to 260 mm; the travel is shorter for this."""
    mill.write_text(mill.read_text().replace("travel = [-300, 300]", "travel = [0, 280]"))

    def error(x):
        return WAVE * np.sin(x / 40.0)

    faces = [0.0, 50.0, 100.002, 149.998, 200.0, 250.0]
    slabs = [Slab((15.0 + at - 10.0, -90.0, -90.0), (15.0 + at, 90.0, 5.0)) for at in faces]
    bench(slabs, (20.0, 10.0, 0.0), screws={"x": error}, backlash={"x": 0.04})
    words = ("--probe", "--touch", "X-", "--faces", *map(str, faces), "--lift", "10")
    code, _, err = cncrun("measure", "pitch", "X", *words, "--yes", "--machine", str(mill))
    assert code == 0, err
    table = load_machine(mill).axes["x"].error_table[1:-1]
    assert [row.place for row in table] == pytest.approx([16.0 + at for at in faces], abs=0.1)
    nuts = np.array([row.place for row in table]) + 0.02
    off = np.array([row.forward for row in table]) - error(nuts)
    assert 0.5 * np.ptp(off) <= 1.0 / BENCH_STEPS
    remark = (mill.parent / "mill-x-errors.csv").read_text().splitlines()[0]
    assert "6 faces over 250 mm, contacts within 0.0" in remark


def test_the_angle_of_two_axes_is_measured_with_the_probe(cncrun, mill, bench, monkeypatch):
    """The inner faces of a square; it is turned over where Enter is pressed."""
    start = np.array((10.0, 20.0, 0.0))
    faulty = FaultyMachine(xy=0.2)

    def legs(corner, up, own):
        tool = faulty.tool(corner[None])[0]
        y = sorted((-6.0 * up, -30.0 * up))
        second = sorted((-30.0 * up, 160.0 * up))
        return [
            Shifted(Slab((-40.0, y[0], -90.0), (190.0, y[1], 90.0), 0.3), tool),
            Shifted(
                Slab((-30.0, second[0], -90.0), (-6.0, second[1], 90.0), 0.3 + own),
                tool,
            ),
        ]

    part = bench(legs(start, 1.0, 0.05), start, xy=0.2, backlash={"x": 0.05})

    class Hands(io.StringIO):
        def readline(self, *_):
            part.slabs[:] = legs(start + (0.0, 120.0, 0.0), -1.0, -0.05)
            return "\n"

    monkeypatch.setattr("sys.stdin", Hands())
    words = ("square", "XY", "--probe", "--lengths", "150", "120", *QUICK)
    code, _, err = cncrun("measure", *words, "--yes", "--machine", str(mill))
    assert code == 0, err
    assert "turn the square over" in err
    angle = load_machine(mill).squareness.xy
    assert float(angle.removesuffix(" deg")) == pytest.approx(0.2, abs=0.005)


def test_a_probe_that_meets_something_on_its_way_ends_the_measurement(cncrun, mill, bench):
    """A clamp stands beside the face. Nothing is written; the same goes for a missing face."""
    before = mill.read_text()
    clamp = Slab((-1.6, -5.0, -9.0), (-1.5, 5.0, 9.0))
    bench([clamp], (0.0, 0.0, 0.0))
    words = ("backlash", "X", "--probe", "--touch", "Y+", "--yes", "--machine", str(mill))
    code, _, err = cncrun("measure", *words)
    assert code == 2
    assert "measure-contact: the probe met something at X-0.5" in err
    bench([Slab((-90.0, 40.0, -9.0), (90.0, 50.0, 9.0))], (0.0, 0.0, 0.0))
    code, _, err = cncrun("measure", *words)
    assert code != 0
    assert "measure-contact: the face is not touched: the probe made no contact" in err
    assert mill.read_text() == before


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("backlash", "X", "--probe", "--touch", "Y+"), "measure-board"),
        (("backlash", "X", "--probe"), "measure-option"),
        (("backlash", "X", "--probe", "--touch", "Y"), "measure-option"),
        (("pitch", "X", "--probe", "--touch", "Y+", "--faces", "0", "50"), "measure-option"),
        (("pitch", "X"), "measure-option"),
    ],
)
def test_a_probe_that_cannot_measure_is_refused(cncrun, mill, words, code):
    exit_code, _, err = cncrun("measure", *words, "--machine", str(mill))
    assert exit_code == 2
    assert f"{code}: " in err


def test_a_lathe_is_not_measured_with_the_probe(cncrun, mill, bench):
    mill.write_text(mill.read_text().replace('"Mill"', '"Lathe"\nkind = "lathe"'))
    bench([Slab((-90.0, 5.0, -9.0), (90.0, 50.0, 9.0))], (0.0, 0.0, 0.0))
    words = ("backlash", "X", "--probe", "--touch", "Y+", "--machine", str(mill))
    code, _, err = cncrun("measure", *words)
    assert code == 2
    assert "measure-option: the probe measures along X" in err


def test_ctrl_c_stops_a_touch(cncrun, mill, bench, monkeypatch):
    """The machine comes to rest before the face, and nothing is written."""
    before = mill.read_text()
    bench([Slab((-90.0, 9.0, -9.0), (90.0, 50.0, 9.0))], (0.0, 0.0, 0.0))
    sent = []
    execute = ProbeBench.execute

    def stopped(self, block, time_ns):
        sent.append(block)
        if len(sent) == 3:
            signal.raise_signal(signal.SIGINT)
        return execute(self, block, time_ns)

    monkeypatch.setattr(ProbeBench, "execute", stopped)
    words = ("backlash", "X", "--probe", "--touch", "Y+", "--yes", "--machine", str(mill))
    code, _, err = cncrun("measure", *words)
    assert code == 130, err
    assert mill.read_text() == before


def test_a_map_that_was_measured_with_the_old_values_is_named(cncrun, mill, typed):
    """The map is not compensated meanwhile, as it has the errors of all axes in it."""
    rows = "".join(
        f"{x},{y},{z},0.01,0,0\n" for x in (-300, 300) for y in (-300, 300) for z in (-300, 300)
    )
    (mill.parent / "map.csv").write_text("x,y,z,dx,dy,dz\n" + rows)
    mill.write_text(mill.read_text().replace('"Mill"', '"Mill"\nerror_map = "map.csv"'))
    typed(BACKLASH)
    code, out, _ = cncrun("measure", "backlash", "X", "--yes", "--machine", str(mill))
    assert code == 0
    assert "machine.error_map was measured with the values before: measure it again" in out

"""Real-time commands of the simulator against GRBL's interface documentation."""

import pytest

from cnc.simulators.grbl.firmware_profile import GRBLHAL
from tests.support.boards.simulator_bench import Bench

FEEDS = [
    (b"\x91", 110),
    (b"\x92", 90),
    (b"\x93", 101),
    (b"\x94", 99),
    (b"\x91\x90", 100),
    (b"\x91" * 12, 200),
    (b"\x92" * 12, 10),
]


@pytest.mark.parametrize(("sent", "percent"), FEEDS)
def test_feed_overrides(sent, percent):
    bench = Bench()
    bench.send("G1X50F200\n", 1.0)
    bench.send(sent, 2.0)
    assert float(bench.status()["FS"].split(",")[0]) == pytest.approx(2 * percent, abs=1)
    assert bench.simulator.core.planner.feed_override == percent


@pytest.mark.parametrize(("sent", "percent"), [(b"\x96", 50), (b"\x97", 25), (b"\x96\x95", 100)])
def test_rapid_overrides(sent, percent):
    bench = Bench()
    bench.send("G0X50\n", 2.0)
    bench.send(sent, 2.0)
    assert float(bench.status()["FS"].split(",")[0]) == pytest.approx(5 * percent, abs=1)


SPEEDS = [
    (b"\x9a", 550),
    (b"\x9b", 450),
    (b"\x9c", 505),
    (b"\x9d", 495),
    (b"\x9a\x99", 500),
    (b"\x9a" * 12, 1000),
]


@pytest.mark.parametrize(("sent", "rpm"), SPEEDS)
def test_spindle_overrides(sent, rpm):
    bench = Bench()
    bench.send("M3S500\n")
    bench.send(sent)
    assert bench.status()["FS"] == f"0,{rpm}"


def test_an_override_is_in_the_next_report_with_the_accessories():
    bench = Bench()
    bench.send("M4S500\nM8\n")
    for _ in range(5):
        bench.status()
    bench.send(b"\x91\x9b")
    report = bench.status()
    assert (report["Ov"], report["A"]) == ("110,100,90", "CF")


def test_spindle_stop_works_only_in_a_hold():
    bench = Bench()
    bench.send("M3S500\n")
    bench.send(b"\x9e")
    assert bench.status()["FS"] == "0,500"
    bench.send("G1X10F300\n", 1.0)
    bench.send("!", 1.0)
    bench.send(b"\x9e")
    assert bench.status()["FS"] == "0,0"
    start = bench.simulator.position
    bench.send("~", 3.5)
    assert bench.status()["FS"] == "0,500" and bench.simulator.position == start
    bench.hear(1.0)
    assert bench.status()["state"] == "Run"


def test_coolant_toggles():
    bench = Bench()
    bench.send(b"\xa0")
    assert "M8" in bench.send("$G\n")[0]
    bench.send(b"\xa0\xa1")
    assert "M9" in bench.send("$G\n")[0]
    hal = Bench(GRBLHAL)
    hal.send(b"\xa1")
    assert "M7" in hal.send("$G\n")[0]


def test_hold_and_resume():
    bench = Bench()
    bench.send("M3S500\nG1X10F300\nX0\n", 1.5)
    bench.send("!", 0.1)
    assert bench.status()["state"] == "Hold:1"
    bench.send("~", 1.0)  # too early: not heard
    assert bench.status()["state"] == "Hold:0"
    stood = bench.simulator.position
    assert bench.send("G1X5\n", 1.0) == [] and bench.simulator.position == stood
    assert bench.status()["FS"] == "0,500"
    assert bench.send("~", 10.0) == ["ok"]
    bench.finish()
    assert bench.simulator.position == (5.0, 0.0, 0.0)


def test_hold_before_the_first_motion_has_begun():
    bench = Bench()
    bench.send("G1X1F300\n!X2\n", 0.5)
    assert bench.status()["state"] == "Hold:0"
    assert bench.simulator.position == (0.0, 0.0, 0.0) and not bench.simulator.moves
    bench.send("~", 5.0)
    assert bench.simulator.position == (2.0, 0.0, 0.0)
    assert [move.end[0] for move in bench.simulator.moves] == [1.0, 2.0]


def test_hold_at_rest_is_complete_at_once():
    bench = Bench()
    bench.send("!", 0.1)
    assert bench.status()["state"] == "Hold:0"
    bench.send("~", 0.1)
    assert bench.status()["state"] == "Idle"


def test_the_door_switches_outputs_off_and_waits_for_them():
    bench = Bench()
    bench.send("M3S500\nM8\nG1X10F300\n", 1.5)
    assert bench.send(b"\x84", 0.05) == ["[MSG:Check Door]"]
    assert bench.status()["state"] == "Door:2"
    bench.hear(2.0)
    bench.simulator.core.environment.door_open = True
    assert bench.status()["state"] == "Door:1"
    bench.send("~", 1.0)
    bench.simulator.core.environment.door_open = False
    assert (bench.status()["state"], bench.simulator.core.rpm) == ("Door:0", 0.0)
    bench.send("~", 4.5)
    assert (bench.status()["state"], bench.simulator.core.rpm) == ("Door:3", 500.0)
    bench.hear(1.0)
    assert bench.status()["state"] == "Run"
    bench.finish()
    assert bench.simulator.position == (10.0, 0.0, 0.0)


@pytest.mark.parametrize("stop", [b"!", b"\x85"])
def test_jog_cancel_drops_the_queue(stop):
    bench = Bench()
    assert bench.send("$J=X10F300\n$J=G91Y10F300\n", 1.0) == ["ok", "ok"]
    assert bench.status()["state"] == "Jog"
    bench.send(stop, 1.0)
    assert bench.status()["state"] == "Idle"
    x, y, _ = bench.simulator.position
    assert 0.0 < x < 10.0 and y == 0.0
    assert bench.send("$G\n")[0].startswith("[GC:G0 G54 G17 G21 G90")
    # The parser goes on from where the machine stands.
    bench.send("G91G1Y1F500\n", 2.0)
    assert bench.simulator.position == (x, 1.0, 0.0)


def test_jog_cancel_affects_only_jogs():
    bench = Bench()
    bench.send("G1X1F300\n", 0.1)
    bench.send(b"\x85")
    bench.finish()
    assert bench.simulator.position == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("byte", [b for b in range(0x80, 0x100) if b not in (0x84, 0xA0)])
def test_bytes_above_ascii_never_enter_a_line(byte):
    bench = Bench()
    assert bench.send(b"G2" + bytes([byte]) + b"1\n", 0.5)[-1] == "ok"


def test_grblhal_has_a_second_set_of_real_time_commands():
    assert len(Bench(GRBLHAL).send(b"\x80", 0.1)) == 1
    assert Bench().send(b"\x80", 0.1) == []
    bench = Bench(GRBLHAL)
    bench.send(b"\x82", 0.1)
    assert bench.status()["state"] == "Hold:0"
    bench.send(b"\x81", 0.1)
    assert bench.status()["state"] == "Idle"


def test_a_jog_cancel_before_the_jog_is_ignored():
    bench = Bench()
    # The byte overtakes the line, which is still on the wire or in the ring.
    bench.send(b"$J=X1F300\n\x85", 2.0)
    assert bench.simulator.position == (1.0, 0.0, 0.0)


def test_grblhal_drops_the_lines_it_has_not_read_at_a_jog_cancel():
    bench = Bench(GRBLHAL)
    jogs = b"$J=G91X0.1F60\n" * 60
    assert bench.send(jogs, 1.0).count("ok") < 50
    # The rest gets no answer, and the board takes the next line as a new one.
    assert bench.send(b"$J=G91Y\x85", 10.0) == ["ok"]
    # One line waited for the planner; it is planned and answered after the cancel.
    assert bench.status()["state"] == "Idle"
    assert bench.send("G91G1Y1F500\n", 3.0) == ["ok"]
    assert bench.simulator.position[1] == 1.0


def test_a_jog_that_waits_for_the_planner_goes_on_from_where_the_cancel_stopped():
    bench = Bench()
    jogs = "".join(f"$J=X{x}F300\n" for x in range(1, 17))
    assert bench.send(jogs, 0.4).count("ok") == 15
    bench.send(b"\x85", 1.0)
    stopped = bench.simulator.moves[-2].reached
    last = bench.simulator.moves[-1]
    assert last.start == pytest.approx(stopped, abs=0.5 / 250.0)
    assert last.end == (16.0, 0.0, 0.0)
    assert 0.0 < stopped[0] < 2.0


@pytest.mark.parametrize("byte", [b"\x91", b"\x97"])
def test_overrides_do_not_change_a_jog(byte):
    bench = Bench()
    bench.send("$J=X5F120\n", 1.0)
    bench.send(byte, 0.1)
    assert bench.status()["FS"].startswith("120,")


@pytest.mark.parametrize("state", ["hold", "check", "alarm", "sleep"])
def test_a_jog_is_refused_unless_idle(state):
    bench = Bench(settings={22: 1.0} if state == "alarm" else None)
    bench.send({"hold": "!", "check": "$C\n", "alarm": "", "sleep": "$SLP\n"}[state], 0.5)
    # A board in hold or asleep answers nothing at all until it is resumed or reset.
    expected = [] if state in ("hold", "sleep") else ["error:8"]
    assert bench.send("$J=X1F100\n", 0.5) == expected
    assert bench.simulator.position == (0.0, 0.0, 0.0)

"""The alarms of the simulator against the tables of GRBL's interface documentation."""

import pytest

from cnc.simulators.grbl.workpiece import Environment
from tests.support.boards.simulator_bench import HOMING, Bench, material_below


def locked(bench):
    """Assert that only a reset is accepted."""
    return bench.send("?$X\n\nG0X0\n?", 1.0) == []


def test_alarm_1_hard_limit():
    bench = Bench(settings={21: 1.0})
    heard = bench.send("G1X120F500\n", 30.0)
    assert heard == ["ok", "ALARM:1", "[MSG:Reset to continue]"]
    assert bench.simulator.position[0] == pytest.approx(100.0)
    assert locked(bench)
    heard = bench.send(b"\x18")
    assert heard == ["Grbl 1.1h ['$' for help]", "[MSG:Check Limits]", "[MSG:'$H'|'$X' to unlock]"]
    assert bench.status()["Pn"] == "X"


def test_alarm_2_soft_limit_without_a_reply_and_the_position_kept():
    bench = Bench(settings=HOMING)
    bench.send("$X\nG1X-50F500\n", 2.0)
    heard = bench.send("G1X-70\nX1\nX-3\n", 10.0)
    assert heard == ["ok", "ALARM:2", "[MSG:Reset to continue]"]
    stood = bench.simulator.position
    assert -50.0 < stood[0] < 0.0 and bench.simulator.moves[0].phases[-1].a == pytest.approx(-500.0)
    assert locked(bench)
    # The line that asked for it is answered late, before the welcome; it must not be counted.
    assert bench.send(b"\x18") == ["ok", "Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"]
    assert bench.simulator.position == pytest.approx(stood, abs=0.004)
    assert bench.status()["state"] == "Alarm"


def test_alarm_2_in_check_mode():
    bench = Bench(settings=HOMING)
    bench.send("$X\n$C\n")
    assert bench.send("G0X1\n") == ["ALARM:2", "[MSG:Reset to continue]"]


def test_alarm_3_reset_while_moving():
    bench = Bench()
    bench.send("G1X10F300\n", 1.0)
    assert bench.send(b"\x18") == [
        "ALARM:3",
        "Grbl 1.1h ['$' for help]",
        "[MSG:'$H'|'$X' to unlock]",
    ]
    assert bench.reply("G0X1") == "error:9"


def test_a_reset_at_rest_raises_no_alarm():
    bench = Bench()
    assert bench.send(b"\x18") == ["Grbl 1.1h ['$' for help]"]
    bench.send("G1X10F300\n", 1.0)
    bench.send("!", 2.0)
    stood = bench.simulator.position
    assert bench.status()["state"] == "Hold:0"
    assert bench.send(b"\x18") == ["Grbl 1.1h ['$' for help]"]
    assert bench.status()["state"] == "Idle"
    assert bench.simulator.position == pytest.approx(stood, abs=0.004)


def test_a_reset_during_braking_raises_an_alarm():
    bench = Bench(settings={120: 1.0})
    bench.send("G1X50F300\n", 10.0)
    bench.send("!", 0.1)
    assert bench.status()["state"] == "Hold:1"
    assert bench.send(b"\x18")[0] == "ALARM:3"


def test_alarm_4_probe_touches_already():
    bench = Bench(environment=material_below(0.0))
    assert bench.send("G38.2Z-10F100\n", 3.0) == ["ALARM:4", "ok"]
    assert bench.reply("G0X1") == "error:9"
    assert Bench().send("G38.4Z-10F100\n", 3.0) == ["ALARM:4", "ok"]


def test_alarm_5_probe_misses():
    bench = Bench()
    assert bench.send("G38.2Z-1F100\n", 3.0) == ["ALARM:5", "[PRB:0.000,0.000,0.000:0]", "ok"]
    assert bench.status()["state"] == "Alarm"
    assert Bench().send("G38.3Z-1F100\n", 3.0) == ["[PRB:0.000,0.000,-1.000:0]", "ok"]


def test_a_reset_within_half_a_second_of_a_limit_alarm_is_ignored():
    """As GRBL 1.1h on an ATmega328P does."""
    bench = Bench()
    bench.send("G1X10F500\n", 0.3)
    assert bench.send("\x18", 0.45) == ["ALARM:3"]
    assert bench.send("?", 0.2) == ["Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"]
    bench = Bench(settings={20: 1.0, 22: 1.0})
    bench.send("$X\n")
    assert bench.send("G1X10F500\n", 0.2) == ["ALARM:2"]
    assert bench.send("\x18", 1.0) == ["[MSG:Reset to continue]"]
    assert bench.send("\x18", 0.2)[-2:] == ["Grbl 1.1h ['$' for help]", "[MSG:'$H'|'$X' to unlock]"]


def test_alarm_6_reset_during_homing():
    bench = Bench(settings=HOMING)
    bench.send("$H\n", 0.5)
    assert bench.send("?", 0.5) == []
    assert bench.send(b"\x18") == [
        "ALARM:6",
        "ok",
        "Grbl 1.1h ['$' for help]",
        "[MSG:'$H'|'$X' to unlock]",
    ]


def test_alarm_7_door_during_homing():
    bench = Bench(settings=HOMING)
    bench.send("$H\n", 0.5)
    assert bench.send(b"\x84") == [
        "ALARM:7",
        "ok",
        "Grbl 1.1h ['$' for help]",
        "[MSG:'$H'|'$X' to unlock]",
    ]


@pytest.mark.parametrize(
    ("environment", "code"), [(Environment(stuck={"Z"}), 8), (Environment(broken={"Z"}), 9)]
)
def test_alarms_8_and_9_the_switch_stays_or_is_not_found(environment, code):
    bench = Bench(settings=HOMING, environment=environment)
    assert bench.send("$H\n", 60.0)[:2] == [f"ALARM:{code}", "ok"]
    assert bench.status()["state"] == "Alarm"

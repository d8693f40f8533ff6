"""The simulator against the tables of GRBL's interface documentation.

Errors, alarms, real-time commands, reports, ``$`` commands.

Codes and causes: ``doc/csv/error_codes_en_US.csv``, ``alarm_codes_en_US.csv`` and ``doc/markdown``
of GRBL 1.1.
"""

from dataclasses import replace

import pytest

from cnc.boards.grbl.simulator.environment import Environment
from cnc.boards.grbl.simulator.firmware_profile import GRBL, GRBLHAL
from tests.support.boards.simulator_bench import Bench

HOMING = {
    20: 1.0,
    22: 1.0,
    25: 5000.0,
    24: 500.0,
    110: 5000.0,
    111: 5000.0,
    112: 5000.0,
    120: 500.0,
    121: 500.0,
    122: 500.0,
}

ERRORS = [
    (1, "10X10"), (1, "=G1X1"), (1, "G1X1*33"),
    (2, "G1X"), (2, "G1X-"), (2, "G1XY1"), (2, "$100=abc"),
    (2, "$Q=1"), (2, "$Z"), (3, "$$$"), (3, "$200=1"), (3, "$GG"), (3, "$RST=Q"), (3, "$N7=G21"),
    (4, "$100=-1"), (4, "G1X1F-100"), (4, "G4P-1"), (4, "M3S-1"), (4, "T-1"),
    (5, "$H"),
    (6, "$0=2"),
    (10, "$20=1"),
    (3, "$J"), (3, "$JX1F10"), (35, "$J=G2X1F10"), (36, "$J=X1F10S5"), (16, "$J=M3X1F10"),
    (16, "$J=G2X1I0.5F10"),
    (20, "G5X1"), (20, "G64"), (20, "M6"), (20, "A10"), (20, "G10L3P1X1"), (20, "G10L2P1R2X1"),
    (20, "G81"),
    (21, "G17G18"), (21, "M3M5"), (21, "G54G55"), (21, "G90G91"), (21, "M8M9"), (21, "G20G21"),
    (21, "G93G94"), (21, "G80G80"),
    (22, "G1"), (22, "G1X1"), (22, "G2X1I0.5"), (22, "G38.2Z-1"), (22, "G93G1X1"), (22, "$J=X1"),
    (23, "G1.5X1"), (23, "M3.1"), (23, "G59.1"), (23, "G80.1"), (20, "G28.2"), (20, "G61.1"),
    (20, "G90.1"), (20, "G92.2"), (20, "G38.6X1"),
    (24, "G0G1X1"), (24, "G10L2P1G1X1F10"), (24, "G28G92X1"), (24, "G43.1Z1G0X1"),
    (25, "G1X1X2F10"), (25, "F1F2"), (25, "N1N2"),
    (26, "G92"), (26, "G10L2P1"), (26, "G2F10"), (26, "G38.2F10"), (26, "$J=F10"),
    (27, "N10000001"),
    (28, "G4"), (28, "G10X1"), (20, "G10P1X1"),
    (29, "G10L2P7X1"),
    (30, "G2G53X1I0.5F10"), (30, "G80G53"),
    (31, "G80X1"),
    (32, "G2Z1F10R5"), (32, "G18G3Y1I1F10"),
    (33, "G2X10Y0I4F10"), (33, "G2X0Y0R5F10"), (33, "G38.2X0F10"), (33, "G2X10Y0.3I5F10"),
    (34, "G2X10Y0R4F10"), (34, "G3X10Y0R-4.9F10"),
    (35, "G2X10F10"), (35, "G18G2X10J5F10"),
    (36, "G1X1F10P1"), (36, "G0X1I1"), (36, "G21K1"), (36, "G4P0L2"), (36, "M5R1"),
    (37, "G43.1X1"), (37, "G43.1"), (37, "G43.1X1Z1"),
    (38, "T256"),
]  # fmt: skip


ON_GRBL_ALONE = [(20, "M7"), (11, "G1" + "X1" * 50)]
"""grblHAL has mist, and longer lines."""
EACH = [(GRBL, *error) for error in ERRORS + ON_GRBL_ALONE] + [
    (GRBLHAL, *error) for error in ERRORS
]


@pytest.mark.parametrize(("profile", "code", "line"), EACH)
def test_each_error_has_its_documented_cause(profile, code, line):
    bench = Bench(profile)
    before = bench.simulator.position
    assert bench.reply(line) == f"error:{code}"
    assert bench.simulator.position == before and not bench.simulator.moves


LEGAL = [
    "", "(a comment) ; and another", "g1 x1 f100", "/G0X1", "G0", "G1F9", "G17G21G90G94G54",
    "G18", "G19", "G91.1", "G40", "G49", "G61",
    "N10000000", "N1.5", "T255", "T1.5", "M1", "M5", "M9", "G80", "G4P0.01", "G4P0", "G43.1Z1",
    "G92X1", "G92.1", "G53G0X1", "G28", "G30.1",
    "G10L20P0X0", "G10L2P6Z1", "G10L2X1", "G93G1X1F60", "G94", "G38.3Z-0.1F100",
    "G2X0Y0I0.01F500", "M3S100", "M4", "$", "$$", "$#",
    "$G", "$I", "$N", "$X", "$N0=G21", "$10=3",
    "$J=G91G21X0.1F500", "$J=G53X0F500", "$J=G20G90Y0F10", "G0 X + 1", "G1X.5F1000", "G1X5.F1000",
    "$I=my board",
]  # fmt: skip


@pytest.mark.parametrize("profile", [GRBL, GRBLHAL])
@pytest.mark.parametrize("line", LEGAL)
def test_legal_lines_are_ok(line, profile):
    assert Bench(profile).reply(line, 5.0) == "ok"


def test_error_7_damaged_memory_is_reported_and_restored():
    bench = Bench()
    bench.reply("$110=777")
    bench.simulator.core.eeprom.damaged.add("settings")
    bench.simulator.power_up()
    heard = bench.hear(2.0)
    assert heard[0] == "error:7" and "$110=500.000" in heard and heard[-1].startswith("Grbl")


def test_error_8_while_moving():
    bench = Bench()
    bench.send("G1X10F100\n", 0.2)
    assert [
        bench.reply(line, 0.2)
        for line in ("$$", "$10=1", "$#", "$I", "$N", "$C", "$H", "$SLP", "$J=X1F10")
    ] == ["error:8"] * 9
    assert bench.reply("$G", 0.2) == "ok"


def test_error_9_in_an_alarm_and_during_a_jog():
    bench = Bench(settings={22: 1.0})
    assert bench.welcome[-1] == "[MSG:'$H'|'$X' to unlock]"
    assert bench.reply("G0X1") == "error:9"
    assert bench.send("$X\n") == ["[MSG:Caution: Unlocked]", "ok"]
    assert bench.reply("$J=X10F100", 0.2) == "ok"
    assert bench.reply("G0X1", 0.2) == "error:9"


def test_error_12_is_a_compile_option():
    bench = Bench(replace(GRBL, max_step_rate_hz=30_000))
    assert bench.reply("$110=7200") == "ok"
    assert bench.reply("$110=7201") == "error:12"


def test_error_13_door_open():
    bench = Bench(settings={22: 1.0}, environment=Environment(door_open=True))
    assert bench.reply("$X") == "error:13"
    assert bench.reply("$H") == "error:13"


def test_error_14_a_text_that_is_too_long_for_the_memory():
    bench = Bench(GRBLHAL)
    assert [
        bench.reply(command + "X" * length) for command in ("$I=", "$N1=(") for length in (80,)
    ] == ["error:14", "ok"]
    assert bench.reply("$N1=" + "G1X1" * 20) == "error:14"
    assert bench.reply("$I=" + "X" * 79) == "ok"


def test_error_15_jog_beyond_the_travel():
    bench = Bench(settings=HOMING)
    bench.send("$X\n")
    assert bench.reply("$J=X1F100") == "error:15"
    assert bench.reply("$J=X-201F100") == "error:15"
    assert bench.reply("$J=X-1F100", 0.5) == "ok"
    assert bench.status()["state"] == "Jog"


def test_error_17_laser_without_a_variable_spindle():
    assert Bench(replace(GRBL, variable_spindle=False)).reply("$32=1") == "error:17"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("X" * 79, "error:2"),
        ("X" * 80, "error:11"),
        (" " * 60 + "(" + "c" * 60 + ")" + "G21", "ok"),
    ],
)
def test_eighty_characters_without_spaces_and_comments(text, code):
    assert Bench().reply(text) == code


def test_grbl_continues_after_an_error_and_grblhal_repeats_it():
    program = "G21\nG1X\nG90\nG90\n\nG90\n"
    assert Bench().send(program) == ["ok", "error:2", "ok", "ok", "ok", "ok"]
    assert Bench(GRBLHAL).send(program) == ["ok", "error:2", "error:2", "error:2", "ok", "ok"]


def test_line_ends():
    assert Bench().send("G21\r\nG90\r\n") == ["ok"] * 4
    assert Bench(GRBLHAL).send("G21\r\nG90\r\n\r\n\n") == ["ok"] * 4


# Alarms


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


SURFACE = ((0.0, 0.0, 1.0), -5.0)


def test_probe_touches():
    bench = Bench(environment=Environment(surface=SURFACE))
    heard = bench.send("G38.2Z-10F100\n", 10.0)
    assert heard == ["[PRB:0.000,0.000,-5.000:1]", "ok"]
    assert -5.3 < bench.simulator.position[2] < -5.0
    assert bench.status()["Pn"] == "P"
    assert "[PRB:0.000,0.000,-5.000:1]" in bench.send("$#\n")
    assert bench.send("G38.4Z0F50\n", 10.0)[0] == "[PRB:0.000,0.000,-5.000:1]"


def test_alarm_4_probe_touches_already():
    bench = Bench(environment=Environment(surface=((0.0, 0.0, 1.0), 0.0)))
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


@pytest.mark.parametrize(("line", "place"), [("G28.1X1", "G28"), ("G30.1X1", "G30")])
def test_axis_words_with_a_stored_position_are_a_motion(line, place):
    """As GRBL 1.1h on an ATmega328P does: the place is stored, then the machine moves."""
    bench = Bench()
    bench.send("G1X2F500\n", 3.0)
    assert bench.reply(line, 3.0) == "ok"
    assert f"[{place}:2.000,0.000,0.000]" in bench.send("$#\n")
    assert bench.status()["MPos"] == "1.000,0.000,0.000"


def test_homing():
    bench = Bench(settings=HOMING)
    assert bench.send("$H\n", 40.0) == ["ok"]
    assert bench.simulator.position == (-1.0, -1.0, -1.0)
    # The switches are at 0 of the environment.
    assert bench.simulator.core.environment.offset == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert bench.status()["state"] == "Idle"


def test_homing_downwards_runs_the_start_up_lines():
    bench = Bench(settings=HOMING | {23: 3.0})
    bench.send("$X\n$N0=G20\n", 1.0)
    assert bench.send("$H\n", 40.0) == [">G20:ok", "ok"]
    assert bench.simulator.position == (-199.0, -199.0, -1.0)


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


# Real-time commands


def test_status_fields_come_as_documented():
    bench = Bench(settings={10: 3.0})
    reports = [bench.status() for _ in range(24)]
    assert all(list(report)[:3] == ["state", "MPos", "Bf"] for report in reports)
    assert [n for n, report in enumerate(reports) if "WCO" in report] == [0, 10, 20]
    assert [n for n, report in enumerate(reports) if "Ov" in report] == [1, 11, 21]
    bench.reply("G92X-5")
    assert bench.status()["WCO"] == "5.000,0.000,0.000"
    bench.reply("$10=0")
    assert bench.status()["WPos"] == "-5.000,0.000,0.000"


def test_positions_are_reported_in_inches():
    bench = Bench(settings={13: 1.0})
    bench.send("G1X25.4F254\n", 1.0)
    assert bench.status()["FS"].startswith("10.0,")
    bench.hear(10.0)
    assert bench.status()["MPos"] == "1.0000,0.0000,0.0000"


def test_line_numbers_are_those_of_the_running_block():
    bench = Bench()
    bench.send("N5G1X1F300\nN6X2\n", 0.1)
    assert bench.status()["Ln"] == "5"
    bench.hear(0.4)
    assert bench.status()["Ln"] == "6"
    bench.hear(2.0)
    assert "Ln" not in bench.status()


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


# Pauses, ends, modes


def test_m0_is_ok_only_after_a_cycle_start():
    bench = Bench()
    assert bench.send("G1X1F300\nM0\nG1X2\n", 5.0) == ["ok"]
    assert bench.status()["state"] == "Hold:0"
    assert bench.send("~", 5.0) == ["ok", "ok"]


def test_the_feed_is_reported_in_the_unit_of_reports():
    bench = Bench()
    bench.send("G20G1F10\n")
    assert " G20 " in bench.send("$G\n")[0] and " F254 " in bench.send("$G\n")[0]
    bench.reply("$13=1")
    assert " F10.0 " in bench.send("$G\n")[0]


def test_m30_resets_the_modes():
    bench = Bench()
    bench.send("G91G18G20G93G55M3S100M8F10\n", 1.0)
    assert bench.send("M30\n") == ["[MSG:Pgm End]", "ok"]
    assert bench.send("$G\n")[0] == "[GC:G1 G54 G17 G20 G90 G94 M5 M9 T0 F0 S100]"


def test_dwell_is_reported_idle_and_answered_at_its_end():
    bench = Bench()
    start = bench.simulator.now
    bench.port.write(b"G4P2.5\n")
    bench.hear(1.0)
    assert bench.status()["state"] == "Idle"
    assert bench.port.read(5.0)
    assert bench.simulator.now - start == pytest.approx(2.5, abs=0.01)


def test_check_mode_moves_nothing_and_ends_with_a_reset():
    bench = Bench()
    assert bench.send("$C\n") == ["[MSG:Enabled]", "ok"]
    assert bench.status()["state"] == "Check"
    assert bench.send("G1X5F100\nG4P100\nG1X\nM3S500\n") == ["ok", "ok", "error:2", "ok"]
    assert bench.send("$C\n") == ["[MSG:Disabled]", "ok", "Grbl 1.1h ['$' for help]"]
    assert bench.simulator.position == (0.0, 0.0, 0.0) and not bench.simulator.moves
    assert not any(event.kind == "spindle" for event in bench.simulator.events)


def test_sleep_ends_in_an_alarm():
    bench = Bench()
    assert bench.send("$SLP\n") == ["ok", "[MSG:Sleeping]"]
    assert bench.status()["state"] == "Sleep"
    assert bench.send("G0X1\n~") == []
    assert bench.send(b"\x18")[-1] == "[MSG:'$H'|'$X' to unlock]"


def test_start_up_lines_run_after_a_reset():
    bench = Bench()
    assert bench.reply("$N0=G20 G91") == "ok"
    assert bench.reply("$N1=G5") == "error:20"
    assert bench.send("$N\n") == ["$N0=G20G91", "$N1=", "ok"]
    assert bench.send(b"\x18") == ["Grbl 1.1h ['$' for help]", ">G20G91:ok"]


@pytest.mark.parametrize("what", ["$", "#", "*"])
def test_restoring(what):
    bench = Bench()
    bench.reply("$110=777")
    bench.reply("G10L2P1X5")
    bench.reply("$N1=G90")
    assert bench.send(f"$RST={what}\n")[:3] == [
        "[MSG:Restoring defaults]",
        "ok",
        "Grbl 1.1h ['$' for help]",
    ]
    everything = bench.send("$$\n") + bench.send("$#\n") + bench.send("$N\n")
    assert ("$110=500.000" in everything) == (what in "$*")
    assert ("[G54:0.000,0.000,0.000]" in everything) == (what in "#*")
    assert ("$N1=" in everything) == (what == "*")


def test_a_power_cycle_keeps_the_memory_and_loses_the_position():
    bench = Bench()
    bench.reply("$110=777")
    bench.reply("G10L2P2Y5")
    bench.send("G92X3\nG0X10\n", 5.0)
    bench.simulator.power_up()
    bench.hear(2.0)
    assert "$110=777.000" in bench.send("$$\n")
    parameters = bench.send("$#\n")
    assert "[G55:0.000,5.000,0.000]" in parameters and "[G92:0.000,0.000,0.000]" in parameters
    assert bench.status()["MPos"] == "0.000,0.000,0.000"


def test_offsets_add_up():
    bench = Bench()
    for line in ("G10L2P1X10Y20Z30", "G92X1", "G43.1Z2"):
        bench.reply(line)
    # G92 X1 where the machine is at 0 and G54 at 10: the shift is -11.
    assert bench.status()["WCO"] == "-1.000,20.000,32.000"
    bench.send("G1X0Y0Z0F500\n", 10.0)
    bench.finish()
    assert bench.simulator.position == (-1.0, 20.0, 32.0)
    bench.reply("G10L20P1X0Y0Z0")
    bench.status()
    assert bench.simulator.core.offset == pytest.approx(bench.simulator.position)


def test_offsets_change_after_the_motion_before():
    bench = Bench()
    bench.status()
    bench.send("G1X1F60\n", 0.2)
    bench.send("G10L2P1X5\n", 0.2)
    assert bench.status()["state"] == "Run"
    assert bench.simulator.core.offset == (0.0, 0.0, 0.0)
    assert bench.hear(2.0) == ["ok"]
    assert bench.status()["WCO"] == "5.000,0.000,0.000"


def test_stored_places():
    bench = Bench()
    bench.send("G0X5Y5Z5\nG28.1\nG0X0Y0Z0\nG91G28Z1\n", 20.0)
    bench.finish()
    assert bench.simulator.position == (0.0, 0.0, 5.0)
    bench.send("G28\n", 5.0)
    bench.finish()
    assert bench.simulator.position == (5.0, 5.0, 5.0)
    assert [move.end for move in bench.simulator.moves[2:4]] == [(0.0, 0.0, 1.0), (0.0, 0.0, 5.0)]


def test_build_info():
    assert Bench().send("$I\n") == ["[VER:1.1h.20190830:]", "[OPT:VN,15,128]", "ok"]
    bench = Bench(GRBLHAL)
    bench.reply("$I=lathe")
    heard = bench.send("$I\n")
    assert (
        heard[0] == "[VER:1.1f.20240125:LATHE]"
        and heard[1] == "[OPT:VNMSL,35,1024,3,0]"
        and "[FIRMWARE:grblHAL]" in heard
    )

"""The error codes of the simulator against the tables of GRBL's interface documentation."""

from dataclasses import replace

import pytest

from cnc.simulators.grbl.firmware_profile import GRBL, GRBLHAL
from cnc.simulators.grbl.workpiece import Environment
from tests.support.boards.simulator_bench import HOMING, Bench

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
    (20, "G5X1"), (20, "G64"), (20, "A10"), (20, "G10L3P1X1"), (20, "G10L2P1R2X1"),
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

ON_GRBL_ALONE = [(20, "M6"), (20, "M7"), (11, "G1" + "X1" * 50)]
"""grblHAL has tool changes, mist, and longer lines."""
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

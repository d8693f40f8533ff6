"""The simulator against GRBL's interface documentation: probing, homing, reports, settings."""

import pytest

from cnc.simulators.grbl.firmware_profile import GRBLHAL, NUMBERED_GRBL
from tests.support.boards.simulator_bench import HOMING, Bench, material_below


def test_probe_touches():
    bench = Bench(environment=material_below(-5.0))
    heard = bench.send("G38.2Z-10F100\n", 10.0)
    assert heard == ["[PRB:0.000,0.000,-5.000:1]", "ok"]
    assert -5.3 < bench.simulator.position[2] < -5.0
    assert bench.status()["Pn"] == "P"
    assert "[PRB:0.000,0.000,-5.000:1]" in bench.send("$#\n")
    assert bench.send("G38.4Z0F50\n", 10.0)[0] == "[PRB:0.000,0.000,-5.000:1]"


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
    bench = Bench(NUMBERED_GRBL)
    bench.send("N5G1X1F300\nN6X2\n", 0.1)
    assert bench.status()["Ln"] == "5"
    bench.hear(0.4)
    assert bench.status()["Ln"] == "6"
    bench.hear(2.0)
    assert "Ln" not in bench.status()


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
    assert Bench().send("$I\n") == ["[VER:1.1h.20190830:]", "[OPT:V,15,128]", "ok"]
    bench = Bench(GRBLHAL)
    bench.reply("$I=lathe")
    heard = bench.send("$I\n")
    assert (
        heard[0] == "[VER:1.1f.20240125:LATHE]"
        and heard[1] == "[OPT:VNMSL,35,1024,3,0]"
        and "[FIRMWARE:grblHAL]" in heard
    )

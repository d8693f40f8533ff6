"""The command ``cncrun settings`` on a simulated board: at a cable, and once at a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cnc.boards.grbl.messages import Firmware
from cnc.boards.grbl.setting_changes import GrblSettings, differing, expected_by
from cnc.boards.grbl.settings import BoardInfo
from cnc.machine.load import load_machine
from cnc.model.diagnostics import UsageError
from cnc.simulators.grbl.firmware_profile import FLUIDNC, GRBL_SETTINGS, GRBLHAL
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import PtyServer
from tests.support.boards.grbl_cable import GrblCable, grbl_cable
from tests.support.boards.grbl_rig import connected


@pytest.fixture
def server() -> Iterator[GrblCable]:
    with grbl_cable(GrblSimulator()) as cable:
        yield cable


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_setting_is_shown_and_changed_at_a_terminal(cncrun) -> None:
    with PtyServer(GrblSimulator(), 10.0) as served:
        shown = cncrun("settings", "11", "--port", served.name)
        assert shown == (0, "$11 = 0.010  junction deviation, mm\n", "")
        assert cncrun("settings", "110=4321", "--yes", "--port", served.name)[0] == 0
        assert served.simulator.core.setting[110] == 4321.0


def test_all_settings_are_shown_with_names_and_differences(cncrun, server: GrblCable) -> None:
    code, out, err = cncrun("settings", "--machine", "grbl-uno", "--port", server.name)
    assert (code, err) == (0, "")
    rows = out.splitlines()
    assert len([row for row in rows if row.startswith("$")]) == len(GRBL_SETTINGS)
    assert "$11 = 0.010  junction deviation, mm" in rows
    (rate,) = [row for row in rows if row.startswith("$110 ")]
    x = load_machine("grbl-uno").axes["x"]
    assert rate.endswith(f"(machine file: {x.max_velocity * 60.0:g})")
    assert "differ from those of the machine file" in rows[-1]
    assert (
        cncrun("settings", "11", "--port", server.name)[1]
        == "$11 = 0.010  junction deviation, mm\n"
    )


def test_a_change_is_confirmed_written_and_read_back(cncrun, server: GrblCable) -> None:
    core = server.simulator.core
    code, _, err = cncrun("settings", "110=4321", "--port", server.name)
    assert code == 2
    assert "needs-yes" in err
    assert core.setting[110] == 500.0
    code, _, err = cncrun("settings", "$110=4321", "--yes", "--port", server.name)
    assert code == 0
    assert "X highest rate, mm/min: 500.000 -> 4321" in err
    assert core.setting[110] == 4321.0
    assert "already" in cncrun("settings", "110=4321.0", "--port", server.name)[1]
    code, _, err = cncrun("settings", "$0=1", "--yes", "--port", server.name)
    assert code == 3
    assert "error:6" in err


def test_all_settings_are_saved_and_restored(cncrun, server: GrblCable, tmp_path: Path) -> None:
    core, file = server.simulator.core, str(tmp_path / "board.txt")
    before = dict(core.setting)
    assert cncrun("settings", "--save", file, "--port", server.name)[0] == 0
    for change in ("12=0.005", "32=1", "122=44"):
        assert cncrun("settings", change, "--yes", "--port", server.name)[0] == 0
    assert core.setting != before
    code, _, err = cncrun("settings", "--load", file, "--yes", "--port", server.name)
    assert code == 0
    assert err.count("->") == 3
    assert core.setting == before


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["abc"], "setting-unknown"),
        (["1100=3"], "setting-unknown"),
        (["110=abc"], "setting-value"),
        (["110="], "setting-value"),
        (["77=1"], "setting-unknown"),
        (["99"], "setting-unknown"),
        (["110=1", "--save", "x"], "usage"),
        (["--load", "no-such-file"], "can-not-read"),
        (["--board", "loopback"], "no-settings"),
    ],
)
def test_wrong_use_is_explained(cncrun, server: GrblCable, arguments: list[str], code: str) -> None:
    port = [] if "--board" in arguments else ["--port", server.name]
    exit_code, _, err = cncrun("settings", *arguments, *port)
    assert exit_code == 2
    assert code in err


def test_a_damaged_file_is_refused_with_its_line() -> None:
    lines = ["; a remark", "$11=0.01 ; mm", "", " 12 = 0.002 "]
    assert GrblSettings.parsed(lines, "board.txt") == {11: "0.01", 12: "0.002"}
    with pytest.raises(UsageError) as caught:
        GrblSettings.parsed(["$11=0.01", "hello"], "board.txt")
    assert (caught.value.diagnostic.file, caught.value.diagnostic.line) == ("board.txt", 2)


def test_texts_and_numbers_are_compared() -> None:
    board = connected(GrblSimulator())
    board.info.settings = {110: "500.000", 70: "grblHAL"}
    settings = board.numbered_settings()
    assert settings.changes({110: "500", 70: "grblHAL"}) == []
    assert [each.number for each in settings.changes({110: "501", 70: "mill"})] == [110, 70]


def test_travel_is_compared_where_the_board_homes() -> None:
    machine = load_machine("grbl-uno")
    settings = {100: "250", 110: "500", 120: "10", 130: "1", 32: "0"}
    at_rest = BoardInfo("1.1h", Firmware.GRBL, settings=settings | {22: "0"})
    homes = BoardInfo("1.1h", Firmware.GRBL, settings=settings | {22: "1"})
    assert 130 not in differing(at_rest, expected_by(machine, at_rest))
    assert 130 in differing(homes, expected_by(machine, homes))


def test_grblhal_names_its_own_settings() -> None:
    class Link:
        info = BoardInfo("1.1f", Firmware.HAL, extensions=frozenset(("ENUMS",)))

        def ask(self, command: str, patience: float):
            from cnc.boards.grbl.messages import message

            assert command == "$ES"
            return [
                message("[SETTING:384|4|Disable G92 persistence||0|||]"),
                message("[SETTING:28|1|G73 Retract distance|mm|6|#####0.000|||]"),
            ]

    names = GrblSettings(Link()).names()  # type: ignore[arg-type]
    assert names[384] == "Disable G92 persistence"
    assert names[28] == "G73 Retract distance, mm"
    assert names[11] == "junction deviation, mm"


def test_settings_of_grblhal_have_its_own_names(cncrun) -> None:
    with grbl_cable(GrblSimulator(GRBLHAL.with_axes("XYZA"))) as served:
        code, out, err = cncrun("settings", "--machine", "grbl-uno", "--port", served.name)
        assert (code, err) == (0, "")
        rows = out.splitlines()
        assert "$11 = 0.010  Junction deviation, millimeters" in rows
        assert "$341 = 0  Tool change mode" in rows
        assert "$103 = 250.000  A steps/mm" in rows
        assert cncrun("settings", "341=4", "--yes", "--port", served.name)[0] == 0
        assert served.simulator.core.setting[341] == 4.0
        code, out, _ = cncrun("boards", served.name)
        assert code == 0
        assert "# extensions ENUMS, RT+, TC" in out and "# SIGNALS: HSEP" in out


def test_fluidnc_without_numbered_settings_is_refused(cncrun, tmp_path: Path) -> None:
    file = tmp_path / "board.txt"
    with grbl_cable(GrblSimulator(FLUIDNC)) as served:
        code, out, err = cncrun("settings", "--save", str(file), "--port", served.name)
    assert (code, out) == (2, "")
    assert "no-settings: the board has no numbered settings (FluidNC 3.7)" in err
    assert not file.exists()


@pytest.mark.parametrize(("before", "after"), [(0.0, 1.0), (1.0, 0.0)])
def test_soft_limits_are_restored_with_the_homing_that_they_need(
    cncrun, tmp_path: Path, before: float, after: float
) -> None:
    file = tmp_path / "board.txt"
    file.write_text(f"$20={after:.0f}\n$22={after:.0f}\n$110=900.000\n")
    simulator = GrblSimulator(settings={20: before, 22: before})
    with grbl_cable(simulator) as served:
        code, _, err = cncrun("settings", "--load", str(file), "--yes", "--port", served.name)
    assert code == 0, err
    assert [simulator.core.setting[number] for number in (20, 22, 110)] == [after, after, 900.0]

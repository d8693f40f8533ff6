"""``cncrun convert`` of programs of lathes: lines by hand, refusals, random programs, the proof."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import pytest

from cnc.convert import writer
from cnc.convert.programs import Converted, convert
from cnc.convert.turning import TARGETS
from cnc.machine.load import load_machine
from cnc.model.blocks import Tool
from cnc.model.choices import DialectName, TargetName
from cnc.model.diagnostics import CncError
from tests.support.corpus.lathes import DIALECTS, TOOLS
from tests.support.corpus.lathes import program as random_program
from tests.support.paths import ROOT
from tests.support.soak import share

TABLE = "T1 P1 X-20 Z-5 D0.8 Q2\nT2 P2 Z1 D0.4 Q2\nT3 P3 D3 Q2\n" + "".join(
    f"T{number} P{number} D0.8 Q2\n" for number in range(4, 13)
)


def converted(
    folder: Path,
    text: str,
    dialect: DialectName,
    to: TargetName = "linuxcnc",
    *,
    tools: str = TABLE,
    **settings: object,
) -> Converted:
    """Convert a text on the shipped lathe, with other settings of the machine."""
    machine = load_machine(ROOT / "config" / "lathe.toml").model_copy(update=settings)
    table = folder / "tools.tbl"
    table.write_text(tools)
    program = machine.program.model_copy(update={"tool_table": table if tools else None})
    file = folder / "program.nc"
    file.write_text(text)
    return convert(str(file), machine.model_copy(update={"program": program}), dialect, to)


def lines(result: Converted) -> list[str]:
    return result.text.decode().splitlines()


PROGRAMS: dict[str, tuple[DialectName, str, list[str]]] = {
    "diameters, feed per revolution, surface speed, tools, an arc": (
        "fanuc",
        "T0101\nG50 S2500\nG96 S180 M3\nG0 X40. Z2. M8\nG1 Z-10. F0.2\nG2 X50. Z-15. R5.\n"
        "G0 U10.\nG28 U0 W0\nT0100\nM30\n",
        ["T1 M6", "G21", "G96 D2500 S180 M3", "(G0 X40. Z2. M8)", "M8", "G7 G90 G95 G54", "G43 H1"]
        + ["G0 X40. Z2.", "G1 Z-10. F0.2", "G18", "G2 X50. Z-15. K0. I5.", "G0 X60."]
        + ["G53 G0 X0. Z0.", "(M30)", "M5", "M9", "M2"],
    ),
    "inches; codes of system A": (
        "fanuc",
        "G20 G97 S600 M3\nT0202\nG0 X2. Z0.1\nG90 X1.9 Z-1. F0.012\nG98 G1 X1. F5.\nM30\n",
        ["G97 S600 M3", "T2 M6", "G97 S600 M3", "G7 G20 G90 G95 G54", "G43 H2", "G0 X2. Z0.1"]
        + ["X1.9", "G1 Z-1. F0.012", "X2.", "G0 Z0.1"]
        + ["G94", "G1 X1. F5.", "(M30)", "M5", "M2"],
    ),
    "a thread": (
        "haas",
        "T202\nG97 S500 M4\nG0 X30. Z5.\nG92 X28.5 Z-20. F1.5\nX28.\nM30\n",
        ["T2 M6", "G97 S500 M4", "G7 G21 G90 G95 G54", "G43 H2", "G0 X30. Z5."]
        + ["(G92 X28.5 Z-20. F1.5)", "X28.5", "G33 Z-20. K1.5", "G0 X30.", "Z5."]
        + ["(X28.)", "X28.", "G33 Z-20. K1.5", "G0 X30.", "Z5.", "(M30)", "M5", "M2"],
    ),
    "radii and diameters": (
        "siemens",
        "G500 G18 G90 G95\nT2 D1\nG97 S600 M3\nG0 X40 Z2\nDIAMOF\nG1 X15 F0.1\nM30\n",
        ["T2 M6", "G97 S600 M3", "G7 G21 G90 G95 G59.3", "G43 H2", "G0 X40. Z2.", "G8"]
        + ["G1 X15. F0.1", "M5", "M2"],
    ),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_lines_of_a_lathe(name: str, tmp_path: Path) -> None:
    dialect, text, expected = PROGRAMS[name]
    result = converted(tmp_path, text, dialect)
    assert [line for line in lines(result) if line] == expected
    assert result.distance <= 0.001


OF_FANUC = (
    "T0101\nG50 S2500\nG96 S180 M3\nG0 X40. Z2. M8\nG1 Z-10. F0.2\nG2 X50. Z-15. R5.\n"
    "G98 G1 X40. F100.\nG28 U0 W0\nG0 Z5.\nG97 S3000\nT0100\nX60.\nM30\n"
)
OF_SIEMENS = (
    "G54 G18 G90 G95\nT2 D1\nG96 S200 LIMS=2000 M4\nG0 X40 Z2\nDIAMOF\nG1 X15 F0.1\nG97 S500\n"
    "G0 X16 Z5\nG33 X18 Z-5 K1.5 SF=90\nX28 Z-10 I2\nG0 X40\nM30\n"
)
OF_LINUXCNC = (
    "G7 G18 G21 G90 G95\nT1 M6\nG43 H1\nG97 S600 M3\nG8\nG0 X20. Z0.\nG33 X23. Z-4. K5.\n"
    "Z-8. K2.\nG0 X30.\nT2 M6\nG43\nG97 S600 M3\nG0 X20.\nM2\n"
)
WRITTEN: dict[str, tuple[DialectName, TargetName, str, list[str]]] = {
    # LIMS holds under G97, too, and G53 keeps the offset of the tool.
    "SINUMERIK's words": (
        "fanuc",
        "siemens",
        OF_FANUC,
        ["T1 D1", "G710", "G96 S180 LIMS=2500 M3", "; G0 X40. Z2. M8", "M8", "DIAMON G90 G95 G54"]
        + ["G0 X40. Z2.", "G1 Z-10. F0.2", "G18", "G2 X50. Z-15. K0. I5.", "G94", "G1 X40. F100."]
        + ["G53 G0 X0. Z0. D0", "D1", "Z5.", "G97 S3000 M3 LIMS=3000", "D0", "X60."]
        + ["; M30", "M5", "M9", "M30"],
    ),
    # X is always a diameter. On the second cone 10 mm of radius are 5 mm of Z, and I counts.
    "FANUC's words": (
        "siemens",
        "fanuc",
        OF_SIEMENS,
        ["%", "T0202", "G21", "G50 S2000", "G96 S200 M4", "G99 G54", "G0 X40. Z2.", "G1 X30. F0.1"]
        + ["G97 S500 M4", "G0 X32. Z5.", "(G33 X18 Z-5 K1.5 SF=90)", "G18"]
        + ["G32 X36. Z-5. F1.5 Q90000", "G32 X56. Z-10. F2.", "(G0 X40)", "G0 X80."]
        + ["M5", "M30", "%"],
    ),
    # Ways of 3 and 4 mm are 5 mm along the move: a lead of 5 there is one of 4 along Z.
    "Haas' words": (
        "linuxcnc",
        "haas",
        OF_LINUXCNC,
        ["%", "T0101", "G97 S600 M3", "G21 G99 G54", "G0 X40. Z0.", "(G33 X23. Z-4. K5.)", "G18"]
        + ["G32 X46. Z-4. F4.", "G32 Z-8. F2.", "(G0 X30.)", "G0 X60.", "(T2 M6)", "M5", "T0202"]
        + ["G97 S600 M3", "X40.", "(M2)", "M5", "M30", "%"],
    ),
    "radii stay on SINUMERIK": (
        "linuxcnc",
        "siemens",
        OF_LINUXCNC,
        ["T1 D1", "G97 S600 M3", "DIAMOF G710 G90 G95 G54", "G0 X20. Z0.", "; G33 X23. Z-4. K5."]
        + ["G18", "G33 X23. Z-4. K4.", "G33 Z-8. K2.", "; G0 X30.", "G0 X30.", "; T2 M6", "M5"]
        + ["T2 D1", "G97 S600 M3", "X20.", "; M2", "M5", "M30"],
    ),
    "a thread in two moves on LinuxCNC": (
        "fanuc",
        "linuxcnc",
        "G97 S600 M3\nG0 X40. Z0.\nG32 X46. Z-4. F4.\nZ-8. F2.\nG0 X60.\nM30\n",
        ["G97 S600 M3", "G7 G21 G90 G95 G54", "G0 X40. Z0.", "(G32 X46. Z-4. F4.)"]
        + ["G33 X46. Z-4. K5.", "G33 Z-8. K2."]
        + ["(G0 X60.)", "G0 X60.", "(M30)", "M5", "M2"],
    ),
    "inches and feet": (
        "haas",
        "siemens",
        "G20 T202\nG50 S2000\nG96 S300 M3\nG0 X2. Z0.1\nG1 Z-1. F0.012\nM30\n",
        ["T2 D1", "G700", "G96 S300 LIMS=2000 M3", "DIAMON G90 G95 G54", "G0 X2. Z0.1"]
        + ["G1 Z-1. F0.012", "; M30", "M5", "M30"],
    ),
    # The spindle follows G50 at once, at its old surface speed; no move sees it.
    "one limit after another": (
        "siemens",
        "fanuc",
        "G54 G18 G90 G95\nG96 S100 LIMS=1000 M3\nG0 X40 Z2\nG1 Z1 F0.1\nG96 S150 LIMS=2000\n"
        "G1 Z0\nM30\n",
        ["%", "G21", "G50 S1000", "G96 S100 M3", "G99 G54", "G0 X40. Z2.", "G1 Z1. F0.1"]
        + [
            "(G96 S150 LIMS=2000)",
            "G50 S2000",
            "G96 S100 M3",
            "G96 S150 M3",
            "Z0.",
            "M5",
            "M30",
            "%",
        ],
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_lines_of_other_lathes(name: str, tmp_path: Path) -> None:
    dialect, to, text, expected = WRITTEN[name]
    result = converted(tmp_path, text, dialect, to)
    assert [line for line in lines(result) if line] == expected
    assert result.distance <= 0.001


@pytest.mark.parametrize("to", TARGETS)
@pytest.mark.parametrize(
    ("name", "dialect"),
    [("turning.nc", "fanuc"), ("haas-shaft.nc", "haas"), ("siemens-shaft.mpf", "siemens")],
)
def test_shipped_programs_of_lathes_are_converted(
    name: str, dialect: DialectName, to: TargetName, tmp_path: Path
) -> None:
    text = (ROOT / "programs" / "lathe" / name).read_text(encoding="ascii")
    assert converted(tmp_path, text, dialect, to).distance <= 0.001


@pytest.mark.parametrize("dialect", DIALECTS)
def test_random_programs_of_lathes_are_converted(dialect: DialectName, tmp_path: Path) -> None:
    """Each is written, read back and compared, or refused for a start angle alone."""
    for seed in range(share(8, 2)):
        text = random_program(random.Random(f"convert {dialect} {seed}"), dialect)
        for to in TARGETS:
            # LinuxCNC alone has no start angle.
            if to == "linuxcnc" and ("SF=180" in text or "Q180000" in text):
                with pytest.raises(CncError, match="begins at the index"):
                    converted(tmp_path, text, dialect, to, tools=TOOLS)
                continue
            result = converted(tmp_path, text, dialect, to, tools=TOOLS)
            assert result.distance <= 0.001


def test_a_result_has_g_code_system_a_and_diameters(tmp_path: Path) -> None:
    """The machine file's system and radii are those of the program, not of the result."""
    lathe = load_machine(ROOT / "config" / "lathe.toml")
    program = lathe.program.model_copy(update={"g_code_system": "B"})
    text = "G97 S600 M3\nG95 G0 X20. Z5.\nG33 Z-5. F2.\nG0 X30.\nM30\n"
    result = converted(tmp_path, text, "fanuc", "haas", program=program, diameters=False)
    assert lines(result)[1:4] == ["G97 S600 M3", "G21 G99 G54", "G0 X40. Z5."]
    assert "G32 Z-5. F2." in lines(result)
    assert any(
        "G-code system A" in text for kind, text in result.notes.remarks if kind == "assumed"
    )


THREAD = "G97 S500 M3\nG0 X30. Z5.\n"
REFUSED: list[tuple[DialectName, str, str]] = [
    ("fanuc", f"{THREAD}G32 Z-20. F1.5 Q180000\nM30\n", "index of the spindle"),
    ("fanuc", f"{THREAD}G34 Z-20. F1.5 K0.1\nM30\n", "changes from turn to turn"),
    ("siemens", "G25 S200\nG26 S3000\nG97 S600 M3\nG96 S100\nG0 X30 Z5\nM30\n", "lowest speed"),
    ("haas", f"{THREAD}P500 M133\nM30\n", "driven tool"),
]


REFUSED_FOR: list[tuple[DialectName, TargetName, str, str]] = [
    *((dialect, "linuxcnc", text, words) for dialect, text, words in REFUSED),
    ("fanuc", "siemens", f"T0112\n{THREAD}M30\n", "tool 1 with the offset 12"),
    ("linuxcnc", "fanuc", f"T100 M6\n{THREAD}M2\n", "tool 100 with the offset"),
    ("linuxcnc", "haas", f"T1 M6\nG43.1 X1 Z2\n{THREAD}M2\n", "has no number"),
    ("linuxcnc", "fanuc", "G96 D900 S90 M3\nG0 X9 Z2\nG96 S90\nG0 Z1\nM2\n", "speed of an earlier"),
    ("siemens", "haas", f"{THREAD}G34 Z-20 K1.5 F0.1\nM30\n", "changes from turn to turn"),
    ("linuxcnc", "siemens", f"{THREAD}G33.1 Z-5 K1\nM2\n", "tapping"),
]


@pytest.mark.parametrize(("dialect", "to", "text", "words"), REFUSED_FOR)
def test_a_line_that_the_control_does_not_have_is_refused(
    dialect: DialectName, to: TargetName, text: str, words: str, tmp_path: Path
) -> None:
    tools = TABLE + "T100 P100 Z1\n"
    with pytest.raises(CncError) as refused:
        converted(tmp_path, text, dialect, to, tools=tools)
    found = refused.value.diagnostic
    assert (found.code, found.line > 0) == ("convert-cannot", True)
    assert words in found.message


NOSE = (
    "T0303\nG97 S500 M3\nG0 X40. Z5.\nG42 G1 X30. Z2. F0.2\nZ-10.\nX36. Z-20.\nG40 G0 X50.\nM30\n"
)


def test_nose_compensation_needs_the_radius(tmp_path: Path) -> None:
    """Without a radius the moves would be those of the program, and G42 would be lost."""
    with pytest.raises(CncError) as refused:
        converted(tmp_path, NOSE, "fanuc", tools="")
    assert refused.value.diagnostic.code == "convert-cannot"
    assert "radius of the nose" in refused.value.diagnostic.message
    result = converted(tmp_path, NOSE, "fanuc")
    assert any("tool table" in text for kind, text in result.notes.remarks if kind == "assumed")


def test_a_spindle_that_is_not_started_again_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forget(self: writer.Writer, _: object, block: Tool) -> None:
        self._out.put(f"T{block.number} M6")

    monkeypatch.setattr(writer.Writer, "_write_tool", forget)
    with pytest.raises(CncError) as refused:
        converted(tmp_path, "G97 S500 M3\nT0202\nG0 X30. Z5.\nG1 Z-5. F0.1\nM30\n", "fanuc")
    assert refused.value.diagnostic.code == "convert-differs"


FORGOTTEN: list[tuple[TargetName, dict[str, object]]] = [
    ("siemens", {"diameters": "DIAMOF"}),
    ("siemens", {"speed_limit": "D"}),
    ("siemens", {"start_angle": ("SF=", 0.5)}),
    ("fanuc", {"feeds": ("G98", "G98")}),
    ("fanuc", {"lead": "K"}),
    ("haas", {"radii": "G8"}),
    ("haas", {"thread": "G33"}),
]


@pytest.mark.parametrize(("to", "wrong"), FORGOTTEN)
def test_a_wrong_code_of_a_control_is_seen(
    to: TargetName, wrong: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each result would move the machine otherwise, or is no program of the control."""
    monkeypatch.setitem(TARGETS, to, replace(TARGETS[to], **wrong))  # type: ignore[arg-type]
    with pytest.raises(CncError) as refused:
        converted(tmp_path, OF_SIEMENS, "siemens", to)
    assert refused.value.diagnostic.code == "convert-differs"


def test_an_action_behind_a_move_in_machine_coordinates(tmp_path: Path) -> None:
    text = "G97 S500 M3\nG0 X30. Z5.\nG53 G0 Z0 M5\nM30\n"
    assert "G53 G0 Z0." in lines(converted(tmp_path, text, "haas"))


def test_coolant_that_is_on_is_not_switched_on_again(tmp_path: Path) -> None:
    text = "T0202\nM8\nG0 X30. Z5.\nM8\nG0 Z6.\nM30\n"
    assert lines(converted(tmp_path, text, "fanuc")).count("M8") == 1

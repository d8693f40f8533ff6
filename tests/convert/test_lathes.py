"""``cncrun convert`` of programs of lathes for LinuxCNC: lines by hand, refusals, the proof."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.convert import writer
from cnc.convert.programs import Converted, convert
from cnc.machine.load import load_machine
from cnc.model.blocks import Tool
from cnc.model.choices import DialectName
from cnc.model.diagnostics import CncError
from tests.support.paths import ROOT

TABLE = "T1 P1 X-20 Z-5 D0.8 Q2\nT2 P2 Z1 D0.4 Q2\nT3 P3 D3 Q2\n" + "".join(
    f"T{number} P{number} D0.8 Q2\n" for number in range(4, 13)
)


def converted(folder: Path, text: str, dialect: DialectName, *, tools: bool = True) -> Converted:
    """Convert a text for LinuxCNC on the shipped lathe."""
    machine = load_machine(ROOT / "config" / "lathe.toml")
    table = folder / "tools.tbl"
    table.write_text(TABLE)
    program = machine.program.model_copy(update={"tool_table": table if tools else None})
    file = folder / "program.nc"
    file.write_text(text)
    return convert(str(file), machine.model_copy(update={"program": program}), dialect, "linuxcnc")


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


@pytest.mark.parametrize(
    ("name", "dialect"),
    [("turning.nc", "fanuc"), ("haas-shaft.nc", "haas"), ("siemens-shaft.mpf", "siemens")],
)
def test_shipped_programs_of_lathes_are_converted(
    name: str, dialect: DialectName, tmp_path: Path
) -> None:
    text = (ROOT / "programs" / "lathe" / name).read_text(encoding="ascii")
    result = converted(tmp_path, text, dialect)
    assert result.distance <= 0.001
    assert any(line.startswith("G7 ") for line in lines(result))


THREAD = "G97 S500 M3\nG0 X30. Z5.\n"
REFUSED = [
    ("fanuc", f"{THREAD}G32 Z-20. F1.5 Q180000\nM30\n", "index of the spindle"),
    ("fanuc", f"{THREAD}G34 Z-20. F1.5 K0.1\nM30\n", "several moves"),
    ("fanuc", f"{THREAD}G76 P011060 Q100 R0.1\nG76 X28. Z-20. P974 Q300 F1.5\nM30\n", "several"),
    ("siemens", "G25 S200\nG26 S3000\nG97 S600 M3\nG96 S100\nG0 X30 Z5\nM30\n", "lowest speed"),
    ("haas", f"{THREAD}P500 M133\nM30\n", "driven tool"),
]


@pytest.mark.parametrize(("dialect", "text", "words"), REFUSED)
def test_a_line_that_linuxcnc_does_not_have_is_refused(
    dialect: DialectName, text: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(CncError) as refused:
        converted(tmp_path, text, dialect)
    found = refused.value.diagnostic
    assert (found.code, found.line > 0) == ("convert-cannot", True)
    assert words in found.message


NOSE = (
    "T0303\nG97 S500 M3\nG0 X40. Z5.\nG42 G1 X30. Z2. F0.2\nZ-10.\nX36. Z-20.\nG40 G0 X50.\nM30\n"
)


def test_nose_compensation_needs_the_radius(tmp_path: Path) -> None:
    """Without a radius the moves would be those of the program, and G42 would be lost."""
    with pytest.raises(CncError) as refused:
        converted(tmp_path, NOSE, "fanuc", tools=False)
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


def test_an_action_behind_a_move_in_machine_coordinates(tmp_path: Path) -> None:
    text = "G97 S500 M3\nG0 X30. Z5.\nG53 G0 Z0 M5\nM30\n"
    assert "G53 G0 Z0." in lines(converted(tmp_path, text, "haas"))


def test_coolant_that_is_on_is_not_switched_on_again(tmp_path: Path) -> None:
    text = "T0202\nM8\nG0 X30. Z5.\nM8\nG0 Z6.\nM30\n"
    assert lines(converted(tmp_path, text, "fanuc")).count("M8") == 1

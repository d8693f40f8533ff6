"""Builders' M-codes, unknown codes, tools without a table, and slips that are warnings."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.machine.program_codes import RunFile, SetOutput
from cnc.model.blocks import BoardCommand, DigitalOutput, NurbsFeed, Stop
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.gcode_cases import block_summaries, error_of, run


def warnings_of(source: str, **options: object) -> list[str]:
    """Return the codes of the warnings and notes of a program."""
    found: list[Diagnostic] = []
    run(source, warn=found.append, **options)
    return [each.code for each in found]


def test_each_effect_of_a_builders_code(tmp_path: Path) -> None:
    (tmp_path / "m33.ngc").write_text("G4 P1\nG0 X7\nM99\n")
    policy = ReadingPolicy(
        codes={
            31: "ignore",
            32: SetOutput(output=3, on=True),
            33: RunFile(file=tmp_path / "m33.ngc"),
            34: "pause",
            35: "pass-on",
        }
    )
    assert run("M31 P3 Q1", policy=policy) == []
    assert run("M032", policy=policy) == [DigitalOutput("test.nc", 1, 3, True, False)]
    assert run("M35", policy=policy) == [BoardCommand("test.nc", 1, "M35")]
    assert block_summaries("M33 G0 X1\nX2", policy=policy) == [
        "rapid 1 0 0", "dwell 1", "rapid 7 0 0", "rapid 2 0 0",
    ]  # fmt: skip
    assert isinstance(run("M34 G0 X1", policy=policy)[-1], Stop)


def test_a_file_that_executes_itself_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "m33.ngc"
    file.write_text("M33\n")
    policy = ReadingPolicy(codes={33: RunFile(file=file)})
    assert error_of("M33", policy=policy).code == "call-too-deep"


def test_an_unknown_code_is_an_error_or_one_warning() -> None:
    found = error_of("M77")
    assert found.code == "code-unknown"
    assert "[program.codes]" in found.hint
    policy = ReadingPolicy(unknown_codes="warn")
    assert warnings_of("M77\nG0 X1 M77 P3", policy=policy) == ["code-skipped"]
    assert error_of("G777", policy=policy).code == "code-unknown"


@pytest.mark.parametrize(
    ("dialect", "line", "codes"),
    [
        ("auto", "G5.1 Q1", ["code-not-needed"]),
        ("auto", "G05 P10000", ["code-not-needed"]),
        ("auto", "G08 P1", ["code-not-needed"]),
        ("auto", "G103 P1", ["code-not-needed"]),
        ("auto", "G22 X9. Y9. Z9. I0. J0. K0.", ["code-not-needed"]),
        ("fanuc", "G23", ["code-not-needed"]),
        ("auto", "G187 P1 E0.01", ["code-not-needed"]),
        ("auto", "G50", []),
        ("haas", "M31", ["code-without-effect"]),
        ("haas", "M88", ["code-without-effect"]),
        ("siemens", "SOFT FFWON", ["code-not-needed", "code-not-needed"]),
        ("siemens", "G601", ["code-not-needed"]),
    ],
)
def test_codes_without_effect_are_named_once(dialect: str, line: str, codes: list[str]) -> None:
    assert warnings_of(f"{line}\n{line}", dialect=dialect) == codes


def test_a_code_is_recognised_by_its_words() -> None:
    assert block_summaries("G8\nG0 X2") == ["rapid 2 0 0"]
    assert block_summaries("G70\nG0 X1\nG71 G91.1\nX1") == ["rapid 25.4 0 0", "rapid 1 0 0"]
    assert error_of("G71 P1 Q2").code == "turning-plane"
    assert isinstance(run("G5.1 X10 I5 J10 F60")[0], NurbsFeed)


def test_lengths_of_zero_are_reported_once() -> None:
    zero = ReadingPolicy(tool_lengths="zero")
    source = "G0 X0\nG43 H1 Z5\nG43 H2 Z6\nG41 D3 X9"
    assert warnings_of(source, policy=zero)[:1] == ["tool-length-zero"]
    assert warnings_of(source, policy=zero).count("tool-length-zero") == 1
    assert error_of(source).code == "tool-table-missing"


def test_a_tool_change_needs_the_tool_in_the_table(tmp_path: Path) -> None:
    file = tmp_path / "tools.tbl"
    file.write_text("T1 P1 Z10 D6\nT2 P2\n")
    assert run("T1 M6\nT0 M6", tools=ToolTable.load(file))
    found = error_of("T5 M6", tools=ToolTable.load(file))
    assert (found.code, found.column) == ("tool-unknown", 4)
    assert error_of("M61 Q9", tools=ToolTable.load(file)).code == "tool-unknown"
    zero = ReadingPolicy(tool_lengths="zero")
    assert error_of("T5 M6", tools=ToolTable.load(file), policy=zero).code == "tool-unknown"
    assert warnings_of("T2 M6\nG43 H2", tools=ToolTable.load(file)) == ["tool-length-zero"]
    assert warnings_of("T1 M6\nG43 H1", tools=ToolTable.load(file)) == []


def test_a_default_feed_holds_until_the_first_f() -> None:
    policy = ReadingPolicy(default_feed=120.0)
    assert block_summaries("G1 X1\nX2 F60", policy=policy) == ["line 1 0 0 F120", "line 2 0 0 F60"]
    assert error_of("G1 X1").code == "feed-missing"


@pytest.mark.parametrize(
    ("source", "rows", "code"),
    [
        ("( hole at (61, 67) )\nG0 X1", ["rapid 1 0 0"], "comment-mended"),
        ("G0 X1 (open", ["rapid 1 0 0"], "comment-mended"),
        ("(cut (a); (b) S1000 (c))\nG0 X1", ["rapid 1 0 0"], "comment-mended"),
        (' //the stock is 3"x1"\nG0 X1', ["rapid 1 0 0"], "comment-mended"),
        ("//O0000Rail-hole DATE=01-02\nG0 X1", ["rapid 1 0 0"], "comment-mended"),
        ("G0 X1 A0", ["rapid 1 0 0"], "axis-idle"),
        ("G0 X1 I0.5 J2", ["rapid 1 0 0"], "word-idle"),
        ("G93\nF10\nG1 X1 F10", ["line 1 0 0 F10"], "word-without-effect"),
        ("%O0001\nG0 X1\nM30\n%", ["rapid 1 0 0", "end"], None),
        (":0001\nG0 X1", ["rapid 1 0 0"], None),
        ("O<PART>\nG0 X1", ["rapid 1 0 0"], None),
        ("N4567.789 G0 X1", ["rapid 1 0 0"], None),
        ("\x1a\nG0 X1\n\x00", ["rapid 1 0 0"], None),
        ("G0 X1 F0", ["rapid 1 0 0"], None),
    ],
)
def test_slips_that_controllers_accept(source: str, rows: list[str], code: str | None) -> None:
    assert block_summaries(source) == rows
    assert warnings_of(source) == ([code] if code else [])


@pytest.mark.parametrize("source", ["//G1 X5 F100", "// X5", "G0 X1 //Y7"])
def test_slashes_before_or_behind_code_are_no_comment(source: str) -> None:
    """Another control may execute the line, or skip it by block delete."""
    assert error_of(source).code == "block-delete-place"
    assert error_of("// the stock", dialect="linuxcnc").code == "block-delete-place"


@pytest.mark.parametrize("dialect", ["marlin", "grbl", "fanuc"])
@pytest.mark.parametrize("line", ["// program of [one] part", "// if #1 is open"])
def test_slashes_before_a_text_are_a_comment_in_every_language(dialect: str, line: str) -> None:
    rules = dialects.load(dialect, lenient=True)
    assert block_summaries(f"{line}\nG0 X1.", dialect=rules) == ["rapid 1 0 0"]


@pytest.mark.parametrize(
    ("switches", "moves"),
    [(False, 3), (frozenset({1}), 2), (frozenset({2}), 2), (True, 1)],
)
def test_block_delete_has_switches(switches: object, moves: int) -> None:
    source = "/G0 X1.\n/2 G0 X2.\nG0 X3."
    assert len(block_summaries(source, dialect="fanuc", block_delete=switches)) == moves


def test_g80_restores_the_move_before_the_cycle() -> None:
    source = "G1 X2. F100\nG81 X5. Z-1. R1.\nG80 X7."
    assert block_summaries(source, dialect="haas")[-1] == "line 7 0 1 F100"
    assert error_of(source, dialect="linuxcnc").code == "motion-missing"


def test_haas_starts_the_spindle_for_a_tap() -> None:
    rows = block_summaries("S500\nG84 X10. Z-5. R2. F500.", dialect="haas")
    assert rows[0] == "spindle cw 500"
    assert error_of("G84 X10. Z-5. R2. F500.", dialect="fanuc").code == "spindle-stopped"
    assert error_of("S5\nG84 X10 Z-5 R2 F500", dialect="linuxcnc").code == "spindle-stopped"


def test_rigid_tapping_of_fanuc_starts_the_spindle() -> None:
    tap = "M29 S500\nG84 X10. Z-5. R2. F500.\nM30"
    assert block_summaries(tap, dialect="fanuc")[0] == "spindle cw 500"
    assert "spindle-started" in warnings_of(tap, dialect="fanuc")
    assert "spindle-started" not in warnings_of(f"M3 S500\n{tap}", dialect="fanuc")


def test_a_decimal_point_in_a_dwell_of_milliseconds() -> None:
    lenient = dialects.load("fanuc", lenient=True)
    assert block_summaries("G4 P0.5\nG4 P500", dialect=lenient) == ["dwell 0.5", "dwell 0.5"]
    assert warnings_of("G4 P0.5", dialect=lenient) == ["dwell-point"]
    assert error_of("G4 P0.5", dialect="fanuc").code == "decimal-point-place"
    assert block_summaries("G4 P0.5", dialect="marlin") == ["dwell 0.0005"]


def test_h_stays_in_effect() -> None:
    tools = ToolTable([ToolEntry(1, 1, {"Z": 40.0})])
    rows = block_summaries("G0 X0.\nG43 H1 Z5.\nG43 Z6.", dialect="haas", tools=tools)
    assert rows[1:] == ["rapid 0 0 45", "rapid 0 0 46"]
    assert error_of("G43 Z6.", dialect="haas", tools=tools).code == "tool-offset-missing"


@pytest.mark.parametrize(
    ("line", "end"),
    [
        ("G91 G28 A0", "rapid 5 6 7"),
        ("G28 B0 C0", "rapid 5 6 7"),
        ("G30 U0 W0", "rapid 5 6 7"),
        ("G91 G28 Z0 A0", "rapid 5 6 0"),
        ("G91 G28", "rapid 0 0 0"),
    ],
)
def test_axes_that_the_machine_lacks_send_no_other_axis_home(line: str, end: str) -> None:
    source = f"G0 X5 Y6 Z7\n{line}"
    assert block_summaries(source)[-1] == end
    assert set(warnings_of(source)) == ({"axis-idle"} if "0" in line else set())

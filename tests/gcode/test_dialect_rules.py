"""Rules in which controllers differ, each by the controller's manual."""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from cnc.gcode.dialects.recognition import recognise
from cnc.model.blocks import Block, Coolant, Dwell, End, Orient, Polyline, Spindle
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.gcode_cases import error_of, points, run, warnings
from tests.support.gcode.offset_tools import table


@pytest.mark.parametrize("dialect", ["linuxcnc", "grbl", "fanuc", "haas", "mach3"])
def test_f0_without_a_feed_move_ends_the_feed(dialect: str) -> None:
    assert points("G90 G0 X1 F0\nM2", dialect) == [(1.0, 0.0, 0.0)]
    found = error_of("G90 G1 X1 F5\nG0 X2 F0\nG1 X3\nM2", dialect=dialect)
    assert (found.code, found.line) == ("feed-missing", 3)
    assert "--default-feed" in found.hint
    assert error_of("G90 G1 X1 F0\nM2", dialect=dialect).code == "feed-not-positive"


def test_the_offset_number_of_fanuc_stays() -> None:
    """D of a tool change or of G43 is that of a later G41."""
    program = "G90 G10 L12 P7 R2\nG43 H0 D7\nG41 G1 X10 F100\nY10\nG40 X20"
    reached = points(program, "fanuc")
    assert reached[0][0] == pytest.approx(10.0 - 2.0)
    assert points(program.replace(" D7", "").replace("G41", "G41 D7"), "fanuc") == reached
    assert error_of("G43 H0 D7", dialect="linuxcnc").code == "word-unused"
    within = "G10 L12 P7 R2\nG41 D7 G1 X10 F100\nX20 D8"
    assert error_of(within, dialect="fanuc").code == "compensation-active"


@pytest.mark.parametrize(("dialect", "word"), [("fanuc", "K0"), ("fanuc", "L0"), ("haas", "L0")])
def test_no_repeat_stores_the_words_of_a_cycle(dialect: str, word: str) -> None:
    """The next line drills with the words of the line that drills nothing."""
    reached = points(f"G90 G0 Z10\nG99 G81 R2 Z-3 F100 {word}\nX5\nG80", dialect)
    assert reached == [(0, 0, 10), (5, 0, 10), (5, 0, 2), (5, 0, -3), (5, 0, 2)]
    here = points(f"G90 G0 Z10\nG99 G81 X0 Y0 R2 Z-3 F100 {word}\nX5\nG80", dialect)
    assert here == reached


def test_no_repeat_is_an_error_of_linuxcnc() -> None:
    found = error_of("G90 G0 Z10\nG99 G81 X1 R2 Z-3 F100 L0", dialect="linuxcnc")
    assert found.code == "value-out-of-range"


def test_names_of_two_letters_in_macro_b() -> None:
    program = "#1=0 (RO[1])\nWH[#1LT2]DO1\n#1=#1+RO[0.9]\nEND1\nG0 X[SQ[4]*#1] Y[sin[90]]"
    assert points(program, "fanuc") == [(4.0, 1.0, 0.0)]


def test_switches_of_block_delete() -> None:
    program = "/G0 X1\n/2 G0 X2\n/9G0 X3"
    every = [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (3.0, 0.0, 0.0)]
    assert points(program, "fanuc") == points(program, "auto", lenient=True) == every
    assert error_of(program, dialect="linuxcnc").code == "letter-missing"
    rest: list[Block] = run(program, dialect="fanuc", block_delete=frozenset({2}))
    assert [block.points.tolist() for block in rest if isinstance(block, Polyline)] == [
        [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]
    ]


def test_a_query_of_the_status_has_no_effect() -> None:
    program = "? ; status\nG0 X1"
    assert points(program, "grbl") == [(1.0, 0.0, 0.0)]
    assert [each.code for each in warnings(program, "grbl")] == ["code-not-needed"]
    assert error_of(program, dialect="linuxcnc").code == "character-unknown"


@pytest.mark.parametrize("dialect", ["linuxcnc", "fanuc", "haas", "mach3"])
@pytest.mark.parametrize(("line", "word"), [("G2 X4 Y4 CR=4. F9", "CR="), ("G0 X=IC(5)", "X=")])
def test_addresses_of_sinumerik_are_named(dialect: str, line: str, word: str) -> None:
    found = error_of(line, dialect=dialect)
    assert (found.code, found.message) == (
        "syntax-not-in-dialect",
        f"{word} is a word of SINUMERIK",
    )


@pytest.mark.parametrize("code", ["M105", "M190", "M104"])
def test_codes_of_printers_are_named(code: str) -> None:
    found = error_of(code, dialect="fanuc")
    assert found.code == "code-not-supported"
    assert "3D printer" in found.message


@pytest.mark.parametrize(
    ("dialect", "is_builders"), [("fanuc", True), ("haas", True), ("mach3", False)]
)
def test_a_printers_code_may_be_a_builders(dialect: str, is_builders: bool) -> None:
    found = error_of("M107", dialect=dialect)
    assert ("a builder's code, or" in found.message) == is_builders


def test_a_repeated_word_says_who_takes_it() -> None:
    found = error_of("M3 S1000 S0", dialect="fanuc")
    assert found.code == "word-repeated"
    assert "FANUC takes the last one" in found.hint


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        ("$PART-3.MIN%\nG0 X20", "Okuma"),
        ("G15 H1\nG0 X20 Y3", "Okuma"),
        ("NOEX VC1=3\nG0 X20 Y3", "Okuma"),
    ],
)
def test_okuma_is_recognised(source: str, kind: str) -> None:
    assert kind in recognise(source.split("\n")).refusal


def test_an_extruder_is_recognised_with_two_digits() -> None:
    assert recognise(["G00 E0"]).dialect == "marlin"


@pytest.mark.parametrize("dialect", ["grbl", "mach3", "siemens", "marlin"])
@pytest.mark.parametrize("code", ["G5.1 Q1", "G05 P10000"])
def test_look_ahead_is_no_spline(dialect: str, code: str) -> None:
    found = error_of(code, dialect=dialect)
    assert found.code == "code-not-in-dialect"
    assert "FANUC" in found.hint
    assert "linuxcnc" not in found.hint


def test_a_dwell_by_x_needs_a_point_unless_the_controller_is_known() -> None:
    (dwell,) = (each for each in run("G4 X2.\nM30") if isinstance(each, Dwell))
    assert dwell.seconds == 2.0
    assert error_of("G4 X2\nM30").code == "decimal-point-needed"
    assert error_of("G4 X2.", dialect="linuxcnc").code == "axis-words-unused"


def test_all_axes_of_haas_return_without_axis_words() -> None:
    assert points("G91 G0 X5 Z5\nG28", "haas") == [(5, 0, 5), (0, 0, 0)]
    assert error_of("G28", dialect="fanuc").code == "axis-words-missing"


@pytest.mark.parametrize(("line", "angle"), [("M19 P90", 90.0), ("M19 R12.5", 12.5), ("M19", 0.0)])
def test_haas_orients_to_an_angle_by_p_or_r(line: str, angle: float) -> None:
    (orient,) = (each for each in run(line, dialect="haas") if isinstance(each, Orient))
    assert (orient.angle, orient.direction) == (angle, "shortest")


def test_p_of_fanucs_orientation_is_unknown() -> None:
    assert error_of("M19 P1", dialect="fanuc").code == "word-unused"


@pytest.mark.parametrize("dialect", ["auto", "haas"])
def test_a_main_program_that_m99_repeats_ends_there_under_auto(dialect: str) -> None:
    program = "%\nO5\nG0 X1.\nM3 S100\nM99\nG0 X2.\n%"
    found: list[Diagnostic] = []
    blocks = run(program, dialect=dialects.load(dialect, lenient=True), warn=found.append)
    assert points(program, dialect, lenient=True) == [(1.0, 0.0, 0.0)]
    assert isinstance(blocks[-1], End)
    assert [each.state for each in blocks if isinstance(each, Spindle)][-1] == "off"
    assert [(each.code, each.line) for each in found] == [("program-ends-once", 5)]
    assert error_of(program, dialect="haas").code == "program-endless"


@pytest.mark.parametrize("line", ["M7 M8", "M8 M7", "M8 G0 X1. M7"])
def test_both_coolants_in_a_line(line: str) -> None:
    """SINUMERIK accepts five M functions in a block; RS274/NGC one of each group."""
    for dialect in ("siemens", "auto"):
        (found,) = (each for each in run(line, dialect=dialect) if isinstance(each, Coolant))
        assert (found.mist, found.flood) == (True, True)
    assert error_of(line, dialect="linuxcnc").code == "modal-conflict"
    assert error_of(f"{line} M9", dialect="auto").code == "modal-conflict"
    assert error_of("M7 M9", dialect="auto").code == "modal-conflict"


def test_an_h_word_waits_for_g43() -> None:
    """H is modal: G43 uses the last one."""
    for dialect in ("fanuc", "haas"):
        for lines in ("T2 H2\nM6\nG43 G0 Z1.", "G43 H1\nG49\nH2\nG0 X1.\nG43 Z1."):
            blocks = run(lines, dialect=dialect, tools=table())
            last = [block for block in blocks if isinstance(block, Polyline)][-1]
            assert last.points[-1, 2] == 101.0, lines
    assert error_of("T2 H2", dialect="linuxcnc").code == "word-unused"


def test_one_way_positioning_is_a_traverse_with_a_note() -> None:
    program = "G0 X9.\nG60 X1.\nX2."
    assert points(program, "fanuc") == points(program.replace("G60 ", ""), "fanuc")
    assert [each.code for each in warnings(program, "fanuc")] == ["code-not-needed"]
    assert error_of(program, dialect="auto").code == "code-not-supported"


def test_haas_mirrors_about_the_work_zero() -> None:
    program = "G10 L2 P1 X100.\nG101 X0\nG0 X5. Y1.\nG100 X0\nX5."
    assert [point[:2] for point in points(program, "haas")] == [(95.0, 1.0), (105.0, 1.0)]
    assert error_of("G101 X5.", dialect="haas").code == "code-not-supported"
    assert error_of("G101", dialect="haas").code == "axis-words-missing"


def test_the_tool_change_of_brother_is_not_read_as_the_end_of_a_mirroring() -> None:
    for line in ("G100 T2 X10. Y20. Z50. S3000 M3", "G100 X1. T2", "G100 T2"):
        for dialect in ("haas", "fanuc"):
            found = error_of(line, dialect=dialect)
            assert found.code == "code-not-supported"
            assert "tool change of Brother" in found.message


@pytest.mark.parametrize(
    ("dialect", "found"),
    [("fanuc", 2000.0), ("haas", 2000.0), ("marlin", 2000.0), ("linuxcnc", None), ("grbl", None)],
)
def test_the_last_of_two_speeds_counts_where_the_controller_says_so(
    dialect: str, found: float | None
) -> None:
    assert error_of("T5 T6", dialect=dialect).code == "word-repeated"
    if found is None or dialect == "marlin":
        assert error_of("S1000 X1 X2", dialect=dialect).code == "word-repeated"
    if found is None:
        assert error_of("M3 S1000 S2000", dialect=dialect).code == "word-repeated"
        return
    blocks = run("M3 S1000 S2000", dialect=dialect)
    assert [block.rpm for block in blocks if isinstance(block, Spindle)] == [found]
    assert [each.code for each in warnings("M3 S1000 S2000", dialect)] == ["word-replaced"]


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "linuxcnc"])
def test_machine_coordinates_under_g91_are_never_guessed(dialect: str) -> None:
    for lenient in (False, True):
        rules = dialects.load(dialect, lenient=lenient)
        found = error_of("G91 G53 G0 X1.", dialect=rules)
        assert found.code == "machine-coordinates-incremental"
    assert [each.code for each in warnings("G91 G53 G0 X1", "auto")] == [
        "machine-coordinates-absolute"
    ]
    assert points("G0 X5\nG91 G53 G0 X1", "auto")[-1] == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("line", "warned"),
    [
        ("G99 G81 X1. R1. Z-2. F100. K2", ""),
        ("G99 G83 X1. R1. Z-2. Q1 F100.", "Q1"),
        ("G2 X10. I5 F100.", "I5"),
        ("G18 G2 X10. I5. K0 F100.", ""),
        ("G0 X#100", ""),
        ("G0 X0", ""),
        ("G0 X100", "X100"),
    ],
)
def test_a_distance_without_a_decimal_point_is_reported(line: str, warned: str) -> None:
    """FANUC's least increment: X100 may be 0.1 mm. K of a cycle counts holes."""
    found = warnings(f"#100=1.\nG0 Z1.\n{line}", "fanuc")
    assert [each.code for each in found] == ["decimal-point-missing"] * bool(warned)
    assert all(warned in each.message for each in found)


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_block_delete_inside_a_line_skips_the_rest_of_it(dialect: str) -> None:
    program = "G0 X1. /Y2. (a/b)\nX3. / Z5.\nG0 X[6./2.] /Y7."
    assert points(program, dialect) == [(1, 2, 0), (3, 2, 5), (3, 7, 5)]
    rest = run(program, dialect=dialect, block_delete=frozenset({1}))
    found = [row for block in rest if isinstance(block, Polyline) for row in block.points.tolist()]
    assert found == [[1, 0, 0], [3, 0, 0], [3, 0, 0]]
    assert error_of(program, dialect="linuxcnc").code == "block-delete-place"


def test_lines_for_the_simulation_of_a_training_mill_are_notes() -> None:
    program = "[BILLET X50 Y50 Z25\n[EDGEMOVE X0 Y0\nG0 X1"
    assert points(program, "auto") == [(1.0, 0.0, 0.0)]
    assert error_of(program, dialect="linuxcnc").code == "letter-missing"


def test_an_accessory_of_haas_needs_other_evidence() -> None:
    assert recognise(["M31", "G0 X1"]).dialect == "auto"
    assert recognise(["O1000", "G0 X1"]).dialect == "fanuc"
    assert recognise(["O1000", "G0 X1", "/M31"]).dialect == "haas"


def test_a_machine_coordinate_code_without_axes_is_reported_and_does_nothing() -> None:
    program = "G0 X1\nG53 G90 G40\nX2"
    assert points(program, "auto") == [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0)]
    assert [found.code for found in warnings(program, "auto")] == ["code-without-effect"]


def test_a_colon_before_words_is_a_line_number() -> None:
    """Some posts mark the line of a tool change; a colon and a number alone are the program's."""
    program = "N10 G0 X1.\n:0020 G0 X2.\nN30 X3."
    assert points(program, "auto") == [(1, 0, 0), (2, 0, 0), (3, 0, 0)]
    assert points(":1000\nG0 X1.\nM30", "fanuc") == [(1.0, 0.0, 0.0)]
    assert error_of(program, dialect="linuxcnc").code == "character-unknown"


@pytest.mark.parametrize(
    ("line", "dialect", "name"),
    [("G111 X1 Y2", "siemens", "pole"), ("G33 Z-10 K1", "siemens", "thread")],
)
def test_codes_that_only_the_controller_has_are_named(line: str, dialect: str, name: str) -> None:
    found = error_of(line, dialect=dialect)
    assert found.code == "code-not-supported"
    assert name in found.message


@pytest.mark.parametrize("code", ["M11", "M25"])
def test_the_error_of_an_m_code_says_where_its_effect_is_given(code: str) -> None:
    assert f'[program.codes] {code} = ".."' in error_of(code, dialect="linuxcnc").hint


@pytest.mark.parametrize(
    ("code", "dialect"),
    [
        ("G47 P0", "haas"),
        ("G68.2 I0 J45. K0", "fanuc"),
        ("G254", "haas"),
        ("G150 P1", "haas"),
    ],
)
def test_the_error_of_a_code_of_the_control_says_what_to_do_instead(
    code: str, dialect: str
) -> None:
    found = error_of(f"O00010\n{code}", dialect=dialect)
    assert found.code == "code-not-supported"
    assert "let the CAM system write" in found.hint


@pytest.mark.parametrize("dialect", ["haas", "auto"])
def test_a_number_with_fanucs_repeats_is_explained(dialect: str) -> None:
    program = "O1\nG0 X1\nM98 P20100\nM30\nO100\nG91 G0 X1\nM99"
    found = error_of(program, dialect=dialect)
    assert found.code == "program-unknown"
    assert "O100, 2 times" in found.hint
    assert "P100 L2" in found.hint
    assert points(program, "fanuc") == [(1, 0, 0), (2, 0, 0), (3, 0, 0)]
    assert "times" not in error_of(program.replace("20100", "20200"), dialect=dialect).hint


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_g10_of_a_recognised_program_sets_g54_to_g59_only(dialect: str) -> None:
    """P7 would be LinuxCNC's G59.1, which no later code of these controls selects."""
    rules = dialects.load(dialect, lenient=True)
    found = error_of("G10 L2 P7 X100.", dialect=rules)
    assert (found.code, found.column) == ("value-out-of-range", 8)
    assert points("G10 L2 P6 X100.\nG59 G0 X1.", dialect, lenient=True) == [(101, 0, 0)]


@pytest.mark.parametrize(
    ("words", "code"),
    [("G4 P2", "dwell-short"), ("G4 P99", "dwell-short"), ("G4 P100", ""), ("G4 P0", ""),
     ("G4 X2.", "")],
)  # fmt: skip
def test_a_short_dwell_in_milliseconds_is_reported(words: str, code: str) -> None:
    """Controllers that count seconds wait a thousand times as long."""
    assert [each.code for each in warnings(words, "fanuc")] == [code] * bool(code)


def test_a_short_dwell_in_seconds_is_not_reported() -> None:
    assert not warnings("G4 P2\nM2", "linuxcnc")


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "auto"])
def test_h0_may_stand_beside_g49(dialect: str) -> None:
    """Both end the length on FANUC's controls, and CAM systems write both."""
    program = "G43 H2 G0 Z5.\nG49 H0\nG0 Z6.\nM2"
    assert points(program, dialect, tools=table())[-1][2] == 6


def test_h_beside_g49_is_an_error_of_linuxcnc() -> None:
    assert error_of("G49 H0\nM2", dialect="linuxcnc").code == "word-unused"
    assert error_of("G49 H1\nM2", dialect="auto").code == "word-unused"


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_outputs_of_macro_b_have_no_effect(dialect: str) -> None:
    lines = ["POPEN", "N5 DPRNT[*X#100[44]*Y]", "/BPRNT [C#101[2]]", "PCLOS (DONE)", "G0 X1."]
    program = "\n".join(lines)
    assert points(program, dialect) == [(1, 0, 0)]
    found = warnings(program, dialect)
    assert [(each.code, each.line, each.severity) for each in found] == [
        ("code-not-needed", line, "note") for line in (1, 2, 3, 4)
    ]
    assert points("IF [1 EQ 1] GOTO 5\nG0 X9.\nN5 DPRNT[A]\nG0 Y2.", dialect) == [(0, 2, 0)]


def test_outputs_of_macro_b_are_an_error_of_linuxcnc() -> None:
    assert error_of("POPEN\nM2", dialect="linuxcnc").code
    assert error_of("DPRNT[X#1] G0 X1", dialect="fanuc").code == "function-unknown"


def test_the_power_of_snapmaker_is_explained() -> None:
    found = error_of("G0 X1\nM3 P100", dialect="auto")
    assert (found.code, "Snapmaker" in found.hint) == ("word-unused", True)

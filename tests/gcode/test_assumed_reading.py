"""What the first lines leave open: units, comments that contradict them, FANUC or Haas."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import check
from cnc.gcode import dialects
from cnc.gcode.dialects.recognition import AssumedReading, assumed_reading, recognise
from tests.support.gcode.gcode_cases import error_of, points


def assumed(source: str, dialect: str = "auto") -> AssumedReading:
    lines = source.split("\n")
    found = recognise(lines) if dialect == "auto" else None
    rules = dialects.load(dialect if found is None else found.dialect, lenient=found is not None)
    return assumed_reading(lines, rules, "part.nc", found)


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ("(ALL DIMENSIONS IN INCHES)\nG0 X1", 1),
        ("G90\n(Units: in)\nG0 X1", 2),
        ("G90\n(all units in inches)\nG0 X1", 2),
        ('G0 X1 (1/2" END MILL)', 1),
        ("; .250 in drill\nG0 X1", 1),
        ("; 1 inch\nG0 X1", 1),
        ("(UNITS = INCH)\nG21 G0 X1", 1),
        ("G20\n(units: mm)\nG0 X1", 2),
        ("G20 ; values in millimetres", 1),
        ("%_N_A_MPF\nG70 G0 X=IC(1) ; UNITS: MM", 2),
        ("O01000\nG70 I1. J0. L3\n(PROGRAM IN INCHES)\nG0 X1.", 3),
    ],
)
def test_a_comment_that_names_other_units_is_a_warning(source: str, line: int) -> None:
    found = assumed(source).doubt
    assert found is not None
    assert (found.code, found.line, found.severity) == ("units-doubtful", line, "warning")


@pytest.mark.parametrize(
    "source",
    [
        'G20\n(1/2" END MILL)\nG0 X1',
        'G21\n(1/2" END MILL, DRAWING IN INCHES)\nG0 X1',
        '(UNITS: MM)\n(3/8" TOOL)\nG0 X1',
        "G0 X1 (HOLD IN VISE)",
        "G0 X1 (OP 10 IN VISE 2)",
        "(UNITS: INCH)\nG20\n(UNITS: MM)\nG21",
        "(POINCHER)\nG0 X1",
        "G21 (All units in mm)\nG0 X1",
        "(units in millimetres)\nG0 X1",
        'MSG "PART 10"\nG0 X1',
    ],
)
def test_a_comment_that_may_agree_is_no_warning(source: str) -> None:
    assert assumed(source).doubt is None


@pytest.mark.parametrize("dialect", ["fanuc", "haas", "grbl", "mach3", "linuxcnc", "siemens"])
def test_the_units_of_comments_are_compared_in_every_dialect(dialect: str) -> None:
    found = assumed("; UNITS: INCH\nG0 X1", dialect).doubt
    assert found is not None
    assert "millimetres, as no code" in found.message


@pytest.mark.parametrize(
    ("dialect", "words"),
    [
        ("siemens", "no G70, G71, G700 or G710"),
        ("fanuc", "no G20 or G21"),
        ("mach3", "no G20 or G21"),
    ],
)
def test_the_assumption_names_the_codes_of_its_dialect(dialect: str, words: str) -> None:
    assert words in assumed("G0 X1", dialect).units


def test_g70_and_g71_name_no_units_on_haas() -> None:
    """They are patterns of holes there: "Bolt Hole Circle" and "Bolt Hole Arc"."""
    assert assumed("G0 X1\nG70 I1. J0. L3", "haas").units
    assert not assumed("G71 G0 X1", "mach3").units
    assert not assumed("G710 G0 X1", "siemens").units


def test_the_warning_is_in_a_check(tmp_path: Path) -> None:
    path = tmp_path / "part.nc"
    path.write_text("(UNITS: INCHES)\nG90 G0 X1.\nM30\n")
    found = [each for each in check(path).as_json()["errors"] if each["code"] == "units-doubtful"]
    assert [each["line"] for each in found] == [1]


NUMBER = "FANUC, not Haas, whose program numbers have five digits, too"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("G10 L12 P1 R5.", "a radius (Haas: a diameter)"),
        ("#1=#2001", "#2001"),
        ("G83 X1. Z-5. R1. Q1. P500 F90.", "P of G73 and G83"),
        ("G51 X0 Y0 P1500", "in thousandths"),
        ("M98 P21000", "number of repeats"),
    ],
)
def test_what_fanuc_and_haas_read_differently_is_named(line: str, words: str) -> None:
    (found,) = assumed(f"O12345\nG21\n{line}").differences
    assert found.startswith(NUMBER)
    assert words in found


def test_nothing_is_named_where_both_read_the_same() -> None:
    assert assumed("O12345\nG21\nG0 X1.\nG83 X1. Z-5. R1. Q1. F90.").differences == (NUMBER,)
    for head in ("O1234", "O01234", "O12345 (HAAS)", "O00012345"):
        assert assumed(f"{head}\nG21\nG10 L12 P1 R5.").differences == ()


def test_p_is_a_whole_number_if_the_text_has_that_program() -> None:
    """With numbers of eight digits P has no repeats, so O10002 is called once."""
    program = "O10001\nG21\nG0 X0.\nM98 P{}\nM30\nO{}\nG91 G0 X3.\nG90\nM99"
    assert points(program.format("10002", "10002"), "fanuc")[-1][0] == 3.0
    assert points(program.format("20002", "0002"), "fanuc")[-1][0] == 6.0


def test_repeats_in_p_need_a_program_of_its_last_digits() -> None:
    program = "O10001\nG21\nG0 X0.\nM98 P20002\nM30\nO0003\nM99"
    assert error_of(program, dialect="fanuc").code == "program-unknown"

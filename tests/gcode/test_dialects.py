"""Dialects: legal codes and meanings of words."""

from __future__ import annotations

import tomllib
from importlib.resources import files

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import GROUP_OF_G, GROUP_OF_M
from cnc.gcode.reader.words import G
from cnc.model.diagnostics import UsageError
from tests.support.gcode.gcode_cases import assert_blocks, error_of, run

FULL = {
    "linuxcnc": "0 1 2 3 4 5 5.1 5.2 5.3 7 8 10 17 18 19 20 21 28 28.1 30 30.1 40 41 41.1 42 42.1 "
    "43 43.1 43.2 49 52 53 54 55 56 57 58 59 "
    "59.1 59.2 59.3 33 33.1 38.2 38.3 38.4 38.5 73 74 76 81 82 83 84 85 86 88 89 98 99 "
    "61 61.1 64 80 90 90.1 91 91.1 92 92.1 92.2 92.3 93 94 95 96 97",
    "grbl": "0 1 2 3 4 10 17 18 19 20 21 28 28.1 30 30.1 40 43.1 49 53 54 55 56 57 58 59 61 80 90 "
    "91 91.1 92 92.1 93 94 "
    "38.2 38.3 38.4 38.5",
    "fanuc": "0 1 2 3 4 6.2 7.1 9 10 15 16 17 18 19 20 21 28 30 31 40 41 42 43 43.4 43.5 44 49 50 "
    "50.1 51 51.1 52 53 53.1 54 54.1 55 56 57 58 59 61 64 65 66 67 68 68.2 69 80 "
    "90 91 92 93 94 95 96 97 73 74 76 81 82 83 84 85 86 88 89 98 99",
}


@pytest.mark.parametrize("name", dialects.NAMES)
def test_every_code_has_a_modal_group(name: str) -> None:
    dialect = dialects.load(name)
    assert dialect.g <= GROUP_OF_G.keys()
    assert dialect.m <= GROUP_OF_M.keys()
    assert dialect.motion.at_start is None or GROUP_OF_G[dialect.motion.at_start] == "motion"


def test_named_unsupported_codes_are_in_no_dialect() -> None:
    rules = [dialects.load(name) for name in dialects.NAMES]
    known = tomllib.loads(files(dialects).joinpath("known.toml").read_text(encoding="utf-8"))
    for kind, unit in (("g", 10), ("m", 1)):
        assert not {
            code
            for code in known[kind]
            if any(round(float(code) * unit) in getattr(each, kind) for each in rules)
        }


@pytest.mark.parametrize("name", FULL)
def test_codes_of_each_dialect(name: str) -> None:
    assert dialects.load(name).g == {round(float(code) * 10) for code in FULL[name].split()}


def test_auto_and_paper_extend_linuxcnc() -> None:
    base = dialects.load("linuxcnc").g
    more = {
        G.G9, G.G12, G.G13, G.G15, G.G16, G.G31, G.G50, G.G50_1, G.G51, G.G51_1, G.G67, G.G68,
        G.G68_2, G.G69, G.G53_1,
    }  # fmt: skip
    assert dialects.load("paper").g == base | {G.G6_2}
    assert dialects.load("auto").g == base | {G.G6_2} | more
    assert dialects.load("linuxcnc").nurbs == dialects.load("grbl").nurbs == ()


def test_an_unknown_dialect() -> None:
    with pytest.raises(UsageError) as caught:
        run("G0 X1", dialect="okuma")
    assert caught.value.diagnostic.code == "unknown-dialect"


@pytest.mark.parametrize(
    ("dialect", "source", "code", "words"),
    [
        (
            "grbl",
            "G06.2 P3 K0",
            "code-not-in-dialect",
            "G06.2 is not in the grbl dialect use --dialect fanuc or haas or paper",
        ),
        (
            "linuxcnc",
            "G6.2 K3 U0",
            "code-not-in-dialect",
            "G6.2 is not in the linuxcnc dialect use --dialect fanuc or haas or paper",
        ),
        (
            "grbl",
            "G61.1",
            "code-not-in-dialect",
            "G61.1 is not in the grbl dialect use --dialect linuxcnc or siemens or fagor or paper",
        ),
        (
            "grbl",
            "G64",
            "code-not-in-dialect",
            "G64 is not in the grbl dialect use --dialect linuxcnc or fanuc or haas",
        ),
        ("grbl", "T1 M6", "code-not-in-dialect", "M6 is not in the grbl dialect"),
        ("fanuc", "G92.2", "code-not-in-dialect", "G92.2 is not in the fanuc dialect"),
        ("grbl", "G43 H1", "code-not-in-dialect", "G43 is not in the grbl dialect"),
        ("linuxcnc", "G44 H1", "code-not-in-dialect", "use --dialect fanuc"),
        ("fanuc", "G38.2 Z-1", "code-not-in-dialect", "use --dialect linuxcnc or grbl"),
        ("grbl", "G81 Z-1 R1", "code-not-in-dialect", "use --dialect linuxcnc or fanuc"),
        ("auto", "G87 Z-1 R1", "code-not-supported", "G87 (back boring cycle) is not supported"),
        (
            "grbl",
            "M98 P1",
            "code-not-in-dialect",
            "M98 is not in the grbl dialect use --dialect linuxcnc or fanuc or haas",
        ),
        ("auto", "G123", "code-unknown", "G123 is unknown"),
        ("auto", "M1000", "code-unknown", "M1000 is unknown"),
        ("auto", "G591", "code-unknown", "G591 is unknown did you mean G59.1 or G51 or G59?"),
        ("auto", "G90.2", "code-unknown", "G90.2 is unknown did you mean G90 or G90.1?"),
        ("auto", "G177", "code-unknown", "G177 is unknown did you mean G17?"),
        ("auto", "M03.1", "code-unknown", "M03.1 is unknown did you mean M3?"),
        ("auto", "M305", "code-unknown", "M305 is unknown did you mean M30?"),
        ("auto", "M300", "code-not-supported", "M300 (sound of a 3D printer) is not supported"),
        ("auto", "G24", "code-not-supported", "G24 (chamfer of Heidenhain in DIN/ISO, or end"),
        ("fanuc", "G45 H1", "code-not-supported", "G45 (a move that a tool offset makes longer)"),
        ("auto", "G0.0000001", "code-unknown", "G0.0000001 is unknown"),
        ("auto", "G[500/4]", "code-unknown", "G125 is unknown"),
        ("grbl", "M6", "code-not-in-dialect", "M6 is not in the grbl dialect"),
        ("auto", "G+177", "code-unknown", "G+177 is unknown did you mean G17?"),
        ("auto", "G123456789", "code-unknown", "G123456789 is unknown"),
        ("auto", "G[100+77]", "code-unknown", "G177 is unknown did you mean G17?"),
        ("fanuc", "G-1", "code-unknown", "G-1 is unknown codes are not negative"),
    ],
)
def test_a_code_is_refused_by_name(dialect: str, source: str, code: str, words: str) -> None:
    found = error_of(source, dialect=dialect)
    assert found.code == code
    assert words in f"{found.message} {found.hint}"


def test_grbl_starts_with_traverses() -> None:
    assert_blocks("X1", ("rapid", 1.0, 0.0, 0.0), dialect="grbl")
    assert error_of("X1", dialect="linuxcnc").code == "motion-missing"


def test_grbl_reads_the_feed_in_the_units_of_its_line() -> None:
    assert_blocks("G20 G1 X1 F1", ("line", 25.4, 0.0, 0.0, 25.4), dialect="grbl")


def test_grbl_has_six_systems_and_no_more_linear_axes_and_no_turns() -> None:
    assert error_of("G10 L2 P7 X1", dialect="grbl").code == "value-out-of-range"
    assert error_of("G0 U1", dialect="grbl", axes=("x", "u")).code == "axis-not-in-dialect"
    assert error_of("G2 X0 I5 P2 F60", dialect="grbl").code == "word-not-in-dialect"


def test_fanuc_dwells_in_milliseconds_or_by_x() -> None:
    assert_blocks(
        "G4 P500\nG04 X1.5\nG1 F60\nG4 X2",
        ("dwell", 0.5),
        ("dwell", 1.5),
        ("dwell", 2.0),
        dialect="fanuc",
    )
    assert error_of("G4 X1 P1", dialect="fanuc").code == "word-wanted-twice"
    assert error_of("G4 X1 G1 F60", dialect="fanuc").code == "word-wanted-twice"


def test_fanuc_g61_stops_exactly() -> None:
    assert_blocks("G61", ("path", "exact-stop", 0.0), dialect="fanuc")
    assert error_of("G64 P1", dialect="fanuc").code == "word-unused"


def test_fanuc_g10_adds_under_g91() -> None:
    assert_blocks(
        "G10 L2 P1 X10\nG91 G10 L2 P1 X5\nG90 G0 X0", ("rapid", 15.0, 0.0, 0.0), dialect="fanuc"
    )
    assert_blocks(
        "%\nG10 L2 P1 X10\nG91 G10 L2 P1 X5\nG90 G0 X0\n%",
        ("rapid", 5.0, 0.0, 0.0),
        dialect="linuxcnc",
    )


@pytest.mark.parametrize("dialect", ["linuxcnc", "fanuc"])
def test_a_program_may_begin_with_its_number(dialect: str) -> None:
    assert run("O1000\nG0 X1\nM2", dialect=dialect)
    error_of("G0 X1\nO1000\nM2", dialect=dialect)

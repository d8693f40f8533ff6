"""Recognition of a program's controller, and the corpus in the style of CAM systems."""

from __future__ import annotations

import random

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.program import ProgramOptions
from cnc.gcode.dialects.recognition import differing_functions, recognise, refuse
from cnc.model.diagnostics import GcodeError
from tests.support.corpus import EXPECTED, STYLES, programs
from tests.support.gcode.gcode_cases import error_of
from tests.support.plain_reader import random_programs
from tests.support.plain_reader.compare import difference
from tests.support.plain_reader.flow import read_plainly
from tests.support.soak import share

ZERO = ProgramOptions(policy=ReadingPolicy(tool_lengths="zero"))
EVIDENCE = [
    ("O1000\nG0 X1", "fanuc"),
    ("%\n:1000\nG0 X1", "fanuc"),
    ("G0 X1\nIF [#1 GT 2] GOTO 10", "fanuc"),
    ("O1000 (HAAS VF2)\nG0 X1", "haas"),
    ("O1000\nG154 P2", "haas"),
    ("G187 P1", "haas"),
    ("%\nO06068 (WINDOW)\nG0 X1.", "haas"),
    ("%\nO60682 (WINDOW)\nG0 X1.", "fanuc"),
    ("%\nO60682 (WINDOW)\nM97 P100", "haas"),
    ("O00001234\nG0 X1", "fanuc"),
    ("%\n<PART-1.NC>(OP 10)\nG0 X1", "fanuc"),
    ("G0 X1\n<PART>", "auto"),
    ("G0 X1\nPOPEN\nDPRNT[X#100[44]]", "fanuc"),
    ("G98 G76 X1. Y2. Z-5. R2. Q0.1 F50.", "fanuc"),
    ("G76 P1.5 Z-20 I-1 J0.2 R1 K1.2 Q29.5", "auto"),
    ("G91 G81 X5. Z-5. R-8. F100. K3", "fanuc"),
    ("G83 Z-9. R1. I2. J.5 K1. F90.", "auto"),
    ("G81 G99 Z-1. R1. F9. L0\nG70 I5. J0. L4", "haas"),
    ("G94 G710 ; mm\nG17\nG0 X1", "siemens"),
    ("o<a> sub\no<a> endsub", "linuxcnc"),
    ("#<depth> = 5", "linuxcnc"),
    ("(1002)\n(  vendor: Tormach)\nG90 G54 G64 G50", "linuxcnc"),
    ("O100 (PART)\n#<depth> = 5", "linuxcnc"),
    ("%\n\n(PART)\nO100 (PART)\nG0 X1", "fanuc"),
    ("PART 17 OF 20\n%\nO0017\nG0 X1", "fanuc"),
    ("G21\nM98 P100 L5\nM2\nO100\nG4 P2\nM99", "auto"),
    ("G21\nM98 Q100\nM30\nN100\nG4 P2\nM99", "fanuc"),
    ("G21\nM98 Q100 P5\nM30\nN100\nG4 P2\nM99", "auto"),
    ("G21\nM98 P100 L5\nM30\nO100\nG12 I2. F9\nM99\nO200\nG65 P100", "fanuc"),
    ("$H\nG0 X1", "grbl"),
    ("; GRBL device profile\nG0 X1", "grbl"),
    ("N10 G71G91.1", "mach3"),
    ("%_N_PART_MPF\nG291\nG0 X1.", "fanuc"),
    (";FLAVOR:Marlin\nG28", "marlin"),
    ("G28 X Y ; home", "marlin"),
    ("G28 X0 Y0", "auto"),
    ("M3 S8000\nG1 X5 F100\nG28 X", "auto"),
    ("T1 M06\nG28 X Y", "auto"),
    ("M3 S20\nG28 X\nG1 X5 E0.2 F100", "marlin"),
    ("G28 X\nM300 S30", "marlin"),
    ("G92 E0\nM6 T1\nM3", "marlin"),
    ("M104 S200\nG1 X1 E0.5", "marlin"),
    ("M104 S205.0", "marlin"),
    ("M109 S0.010 (pulse of a laser)", "auto"),
    ("%_N_A_MPF\nG0 X1", "siemens"),
    ("O02345\nG77 X1. Z-1. R1. I.1 F10.", "haas"),
    ("G0 X=IC(5)", "siemens"),
    ("R1=5", "siemens"),
    ("WHILE 1==1\nG1 X1\nENDWHILE", "siemens"),
    ("N5 IF X_POS<>3 GOTOF_A", "siemens"),
    ("G0 X1\nWARMUP(3600, 5) ; run in", "siemens"),
    ("N10 L_GROOVE(R1,2.5)", "siemens"),
    ("M6(1)\n(POS(3,4))\nG0 X1", "auto"),
    ("G0 X1\nG1 X2 F100", "auto"),
    ("T1 M6\nG43 H1 Z5.\nM30", "auto"),
    ("(O1000 in a comment)\nG0 X1", "auto"),
    ("\0\0%\n\2O1000\nG0 X1", "fanuc"),
    ("; a text\nPART HOLDER\nX5", "auto"),
    ("; a text", "auto"),
    ("", "auto"),
    ("0 BEGIN PGM A MM\n1 TOOL CALL 1 Z S2000", "heidenhain"),
    ("begin pgm a mm\nM30", "heidenhain"),
    ("12 L X+5 Y-3 R0 FMAX", "heidenhain"),
    ("CYCL DEF 200 BOHREN ~\nQ200=2", "heidenhain"),
]


@pytest.mark.parametrize(("source", "dialect"), EVIDENCE)
def test_the_first_lines_name_the_dialect(source: str, dialect: str) -> None:
    found = recognise(source.split("\n"))
    assert found.dialect == dialect
    assert bool(found.reasons) == (dialect != "auto")
    assert found.described().startswith(dialect)


def test_the_ending_of_a_name_is_evidence() -> None:
    assert recognise(["LP PR+1 PA+2"], file="part.H").dialect == "heidenhain"
    assert recognise(["LP PR+1 PA+2"], file="part.h.nc").dialect == "auto"
    assert recognise(["G291", "G0 X1"], file="part.h").dialect == "fanuc"


def test_the_reasons_name_words_and_lines() -> None:
    (reason,) = recognise(["", "G0 X1", "G187 P1"]).reasons
    assert str(reason) == "G187 in line 3 (a code of Haas)"


@pytest.mark.parametrize(
    ("source", "code", "words"),
    [
        ("%PART G71 *\nN10 G00 G40 G90 Z+100 *", "not-gcode", "Heidenhain program in DIN/ISO"),
        ("N10 G99 T1 L+0 R+5 *\nN20 T1 G17 S500 *", "not-gcode", "Heidenhain program in DIN/ISO"),
        ("G21 G90\nG0 X1".encode("utf-16-le").decode("latin-1"), "not-gcode", "UTF-16"),
        ("\ufffd\ufffd" + "G21 G90".encode("utf-16-be").decode("latin-1"), "not-gcode", "UTF-16"),
        ("PK\x03\x04\x14\x00", "not-gcode", "compressed"),
        ("%PDF-1.4\n1 0 obj", "not-gcode", "PDF"),
        ("%FSLAX24Y24*%\nX100Y100D01*", "not-gcode", "Gerber"),
        ("M48\nMETRIC,TZ\nT1C0.8", "not-gcode", "Excellon"),
        ("%%3000\nM47,FRONT\nX5Y5T1", "not-gcode", "circuit boards (Sieb & Meyer)"),
        ("MS,1.0,0.5\nJZ,5", "not-gcode", "ShopBot"),
        ("C6\nSA\nM3 0,0,0.15\nJ3 0.1293,0.1311,0.15", "not-gcode", "ShopBot"),
        ("IN;SP1;PU0,0;", "not-gcode", "HPGL"),
        ("<!DOCTYPE html>", "not-gcode", "web page"),
        ("N1 R20=5\nN2 @136 R20 K50 K300", "not-gcode", "older SINUMERIK"),
        ("N1 G0 X1\nN2 R01=1 R02=0. R22=36.4 L903", "not-gcode", "older SINUMERIK"),
        ("#50=0\n#1505=-5000(Wrong settings)\nM30", "not-gcode", "a macro of a DDCS"),
        ("M558 F200\nG0 X1", "not-gcode", "RepRapFirmware"),
        ("N10 T2.12\nN20 M6\nN30 G0 G90 G43 Z100", "not-gcode", "may be for a lathe, by T2.12 in"),
        (': (PGM, NAME="1001")\n; T1\n: G90 G40 G94\nG17', "not-gcode", "Acramatic"),
        (":T1 M6\nS15000 M3\nH0", "not-gcode", "Acramatic"),
        ("%PM\nN9001\nN10 G17\nN20 G2 X20 Y10 I10 J10 F9", "not-gcode", "Philips control"),
        ("%MM\nN9002\nN10 G1 X1 F9", "not-gcode", "Philips control (MAHO), whose centres"),
        ("N9001\n(PART)\nN10 G17\nN20 G2 X20 Y10 I10 J10 F9", "not-gcode", "by N9001 in line 1"),
        ("O00012\nG90\nG100 T2 X1. Y2. G43 Z50. H2 S3000 M3", "not-gcode", "Brother control"),
        ("O00012\nN5 G100 X1. Y2. Z50. T#531", "not-gcode", "Brother control"),
        ("%FEED = global.feed || 150\nG21", "not-gcode", "a macro of a sender program"),
        ("//Note: MillMaster Pro\nG70\nG1 X1 F9", "not-gcode", "tenths of an inch"),
        ("sub change_tool\nG0 X1\nendsub", "not-gcode", "EdingCNC"),
        ("G20\nL91\nM11C1\nG0 X1", "not-gcode", "WinCNC"),
        ("N0; Post Processor: proLIGHT 1000\nN1G0X5Y5\nN2G2X5Y5I0J5F9", "not-gcode", "proLIGHT"),
        ("%100\nN10 G0 G52 Z0\nN40 G79 N20", "not-gcode", "NUM control, by G79 N20 in line 3"),
        ("%9\nN5 G79 L1=5 N20", "not-gcode", "NUM control"),
        ("%9\nN5 G77 H200 S2", "not-gcode", "NUM control"),
        ("%9\nL0=5 L1=L0+1\nG0 XL0", "not-gcode", "NUM control, by L0=5"),
        ("O1234\nG90 G0 S5000 M3 E1 X0. Y0.\nH1 Z1. M8", "not-gcode", "Fadal"),
        ('M291 P"Zero set?" S3', "not-gcode", "Duet"),
        ("G10 L20 P1 X{param.R*-1}", "not-gcode", "RepRapFirmware"),
        ("T0101\nG50 S2000\nG96 S150 M3\nG99 G1 Z-10. F0.2", "program-for-lathe", "T0101"),
        ("M109 S200\nG1 X1 E0.5", "program-for-printer", "M109 S2"),
        ("Hello, a text.\nIts second line.", "not-gcode", "plain text, by Hello, a text."),
        ("(a)\ndef main():\n    pass", "not-gcode", "def main(): in line 2"),
    ],
)
def test_a_foreign_file_has_one_error_that_names_it(source: str, code: str, words: str) -> None:
    with pytest.raises(GcodeError) as caught:
        refuse(recognise(source.split("\n")), "mill", "part.nc")
    found = caught.value.diagnostic
    assert found.code == code
    assert words in found.message
    assert found.line >= 1


@pytest.mark.parametrize("source", ["N9001 G17\nG1 X1 F9", "N90010\nG1 X1 F9", "%PMX\nG1 X1 F9"])
def test_a_number_with_code_behind_it_points_to_no_control(source: str) -> None:
    assert recognise(source.split("\n")).refusal == ""


def test_a_printer_takes_its_programs() -> None:
    refuse(recognise(["M109 S200"]), "printer", "part.gcode")


def test_a_program_with_y_words_is_no_lathe_program() -> None:
    mill = ["T0101 M6", "G50", "G96 S150", "G0 X1. Y2.", "G99 G81 Z-1. R1. F100."]
    refuse(recognise(mill), "mill", "part.nc")


def test_a_lathe_with_driven_tools_has_a_y_axis() -> None:
    turned = ["O1234", "G0 T0101", "G97 S206 M3", "G50 S3600", "G96 S200", "G99 G1 X-.0625 F.01"]
    milled = ["G28 U0. V0. W0.", "G0 T0202", "G98 G1 Y-.75 F45."]
    with pytest.raises(GcodeError) as caught:
        refuse(recognise(turned + milled), "mill", "part.nc")
    assert caught.value.diagnostic.code == "program-for-lathe"
    assert recognise(milled).lathe == ()


def test_mirroring_of_haas_needs_other_evidence() -> None:
    assert recognise(["G101 X0"]).dialect == "auto"
    assert recognise(["O1234", "G101 X0"]).dialect == "haas"


def test_the_number_of_a_program_counts_once() -> None:
    found = recognise(["O100", "G64 P0.01", "M98 P100", "O200"])
    assert (found.dialect, found.rival) == ("fanuc", "linuxcnc")
    assert recognise(["O100", "G64 P0.01"]).rival == "fanuc or linuxcnc"


def test_equal_evidence_for_two_dialects_decides_nothing() -> None:
    found = recognise(["; GRBL", "; LinuxCNC"])
    assert (found.dialect, found.rival) == ("auto", "grbl or linuxcnc")


@pytest.mark.parametrize("style", [*STYLES][:: share(1, 2)])
def test_a_second_reader_finds_the_same_moves_in_the_corpus(style: str) -> None:
    """Each style is read in its dialect, without an error.

    Lines, ends, extents, feeds, and what is a traverse are those of the second reader.
    """
    count = 0
    for _, seed, text in programs(share(200, 1), [style]):
        lines = text.splitlines()
        dialect = recognise(lines).dialect
        assert dialect in (EXPECTED[style], "grbl"), seed
        assert len(read_plainly(lines, dialect)) > 3, seed
        assert not difference(lines), seed
        count += 1
    assert count


@pytest.mark.parametrize("dialect", random_programs.HEADS)
def test_a_second_reader_finds_the_same_moves_in_random_programs(dialect: str) -> None:
    for seed in range(share(3000, 2)):
        lines = random_programs.program(random.Random(f"{dialect} {seed}"), dialect)
        assert recognise(lines).dialect == dialect
        assert not difference(lines), "\n".join(lines)


TWO_READERS = """G21 G90
G0 X5 Y5 Z5
G1 Z-1 F100
G2 X15 Y5 I5 J0
G0 Z4
G98 G81 X20 Y5 Z-3 R1
G80
G0 Z9"""


@pytest.mark.parametrize(
    ("written", "misread"),
    [
        ("G21", "G20"), ("G90", "G91"), ("G2", "G3"), ("I5", "I5.1"), ("Z-3", "Z-2"),
        ("R1", "R2"), ("F100", "F200"), ("G0 Z9", "G1 Z9"), ("G0 Z9", ""), ("G98", "G99"),
    ],
)  # fmt: skip
def test_the_second_reader_sees_a_misreading(written: str, misread: str) -> None:
    assert not difference(TWO_READERS.split("\n"))
    changed = TWO_READERS.replace(written, misread)
    assert difference(TWO_READERS.split("\n"), plainly=changed.split("\n"))


def test_the_corpus_has_two_hundred_programs() -> None:
    assert len({text for _, _, text in programs(10)}) >= 195


def test_a_lenient_dialect_keeps_its_meanings() -> None:
    haas, strict = dialects.load("haas", lenient=True), dialects.load("haas")
    assert haas.dwell == strict.dwell
    assert haas.cycles == strict.cycles
    assert haas.g >= strict.g | dialects.load("auto").g
    assert haas.lenient
    assert not strict.lenient


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("echo tool change", "console"),
        ("N196 G81 X8. Y0.0 R3=-.023 R10=10.5 F250.", "older SINUMERIK"),
    ],
)
def test_lines_that_only_another_language_has(line: str, kind: str) -> None:
    found = recognise(["G17 G90", line])
    assert kind in found.refusal
    assert found.reasons[0].line == 2


@pytest.mark.parametrize("code", ["G92.4 A0", "M25", "M321", "M490", "M198 P1"])
def test_codes_of_other_controllers_are_named(code: str) -> None:
    assert error_of(f"{code}\nM2", dialect="auto").code == "code-not-supported"


@pytest.mark.parametrize(
    ("code", "name"), [("M59 P1", "an output on"), ("M69 P1", "an output off")]
)
def test_codes_of_haas_are_named(code: str, name: str) -> None:
    found = error_of(f"O1\n{code}\nM30", dialect="haas")
    assert found.code == "code-not-supported"
    assert name in found.message
    assert "[program.codes]" in found.hint
    assert error_of(f"O1\n{code}\nM30", dialect="fanuc").code == "code-unknown"


def test_a_code_of_another_dialect_may_be_a_builders() -> None:
    hint = error_of("O1\nM79\nM30", dialect="fanuc").hint
    assert "--dialect haas" in hint
    assert '[program.codes] M79 = ".."' in hint


def test_a_program_in_two_languages_is_refused_by_name() -> None:
    found = error_of("G0 X1\nG291\nG0 X2.\nM30", dialect="siemens")
    assert (found.code, found.line) == ("code-not-supported", 2)
    assert "ISO mode" in found.message
    found = error_of("G291\nG0 X1.\nG290\nM30", dialect="fanuc")
    assert (found.code, found.line) == ("code-not-supported", 3)


@pytest.mark.parametrize("code", ["M100", "M199 P1 Q2"])
def test_commands_of_the_user_are_named(code: str) -> None:
    found = error_of(f"{code}\nM2", dialect="linuxcnc")
    assert found.code == "code-not-supported"
    assert "M100 to M199" in found.message
    assert "[program.codes]" in found.hint
    assert error_of("M200\nM2", dialect="linuxcnc").code == "code-unknown"


@pytest.mark.parametrize("code", ["G17.1", "G18.1", "G19.1", "G87 X1 Z-1 R1"])
def test_codes_of_linuxcnc_that_are_not_read_are_named(code: str) -> None:
    assert error_of(f"{code}\nM2", dialect="linuxcnc").code == "code-not-supported"


def test_functions_that_controllers_compute_differently_are_named() -> None:
    """FANUC joins the bits of numbers, LinuxCNC their truth; of comparisons both are the same."""
    assert differing_functions(["#1=[6 XOR 3 OR 1]", "#2=FIX[#1]"]) == (
        "FIX of negative numbers",
        "OR, XOR of other numbers than 0 and 1",
    )
    for same in ("o1 if [[#1 GT 2] AND [#2 LT 3]]", "(THIS AND THAT)", "#<_land> = 1", "G1 X[1+2]"):
        assert differing_functions([same]) == ()

"""``cncrun convert``: programs of one control for another, and what is refused."""

from __future__ import annotations

import gc
import json
import random
import re
import tempfile
import tracemalloc
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cnc import parse
from cnc.cli import exit_code
from cnc.convert import programs, writer
from cnc.convert.programs import Converted, convert
from cnc.gcode.reader import source_text
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.blocks import ArcFeed, Dwell, NurbsFeed, Polyline, Stop
from cnc.model.choices import Curves, DialectName, TargetName
from cnc.model.diagnostics import CncError
from tests.support.corpus import EXPECTED, STYLES
from tests.support.soak import share

MACHINE = load_machine(None)
Convert = Callable[..., Converted]


@pytest.fixture
def converted(tmp_path: Path) -> Convert:
    """Return a function that converts a text."""

    def run(
        text: str,
        dialect: DialectName,
        to: TargetName,
        curves: Curves = "lines",
        tolerance: float = 0.01,
    ) -> Converted:
        file = tmp_path / "program.nc"
        file.write_text(text)
        return convert(str(file), MACHINE, dialect, to, tolerance=tolerance, curves=curves)

    return run


def lines(result: Converted) -> list[str]:
    return result.text.decode().splitlines()


def moves(path: Path, dialect: DialectName) -> np.ndarray:
    """Return the ends of all moves, read in a dialect."""
    blocks = [
        block for block in parse(path, dialect=dialect) if isinstance(block, Polyline | ArcFeed)
    ]
    return np.concatenate(
        [block.points if isinstance(block, Polyline) else block.end[None] for block in blocks]
    )


# Lines that are kept


def test_lines_with_the_same_meaning_stay_as_they_are(converted: Convert) -> None:
    text = (
        "N10 G90 G21 (safe line)\nN20 G0 X1. Y2.\n\n"
        "N30 G1 Z-1. F100 (cut)\nN40 G2 X3. I1.\nN50 M30\n"
    )
    result = converted(text, "fanuc", "grbl")
    assert result.text.decode() == text.replace("N20 G0", "G17 G94 G54\nN20 G0")
    assert (result.notes.kept, result.notes.expanded) == (6, 0)
    assert result.distance == 0.0


def test_cycles_and_offsets_stay_where_the_control_has_them(converted: Convert) -> None:
    text = "G90 G17 G21 G94 G55\nG0 X1. Y2. Z5.\nG98 G81 Z-3. R2. F100.\nX5.\nG80\nM30\n"
    assert "\n".join(lines(converted(text, "fanuc", "haas"))[1:-1]) + "\n" == text


def test_loops_and_calls_stay_where_the_flow_is_the_same(converted: Convert) -> None:
    text = (
        "%\nO0001\nG21 G90 G94 G17\nG0 Z5.\n#1=0\nWHILE[#1 LT 3]DO1\n"
        "G0 X#1\n#1=#1+1\nEND1\nM30\n%\n"
    )
    result = converted(text, "fanuc", "haas")
    assert result.text.decode() == text
    assert (
        "kept",
        "loops, branches, calls and computed words as they stand",
    ) in result.notes.remarks


@pytest.mark.parametrize(
    ("to", "wanted"),
    [
        ("fanuc", "G1 X10. Y-2.5 (x)"), ("haas", "G1 X10. Y-2.5 (x)"),
        ("siemens", "G1 X10 Y-2.5 ;x"), ("marlin", "G1 X10 Y-2.5 ;x"),
        ("mach3", "G1 X10 Y-2.5 (x)"),
    ],
)  # fmt: skip
def test_the_spelling_is_that_of_the_control(
    converted: Convert, to: TargetName, wanted: str
) -> None:
    assert wanted in lines(
        converted("G21 G90\nG1 X10 Y-2.5 F100 ;x\nX9\nG1 X10 Y-2.5 ;x\nM2\n", "linuxcnc", to)
    )


def test_the_radius_of_an_arc_is_no_parameter_of_sinumerik(converted: Convert) -> None:
    text = "G21 G90 G17\nG0 X0. Y0.\nG1 X1. F100.\nG2 X5. R3. (R2)\nG3 X9. Y0. R-2.5 F90.\nM30\n"
    found = lines(converted(text, "fanuc", "siemens"))
    assert found[0] == "G710 G90 G17"
    assert found[-3:-1] == ["G2 X5. CR=3. ; R2", "G3 X9. Y0. CR=-2.5 F90."]


def test_inches_of_sinumerik_are_those_of_feeds_too(converted: Convert) -> None:
    text = (
        "(G20)\nG90 G020 G17\nG0 X0. Y0. Z1.\nG1 X1. F10.\nG21\nG81 X9. Y0. Z-1. R0.5 F90.\nM30\n"
    )
    found = lines(converted(text, "fanuc", "siemens"))
    assert found[:2] == ["; G20", "G90 G700 G17"]
    assert "G710" in found
    assert not any(re.match("[^;]*G2[01]", line) for line in found)


def test_a_comment_for_grbl_has_no_real_time_command(converted: Convert) -> None:
    result = converted("(Why? Go! ~ \u00e4)\nG0 X1. (stop!)\nM30\n", "fanuc", "grbl")
    assert not re.search(rb"[?!~\x80-\xff]", result.text)


# Lines that are written anew


def test_a_drilling_cycle_becomes_its_moves(converted: Convert) -> None:
    text = "G90 G21 G17 G94 G54\nG0 X1. Y2. Z5.\nG98 G82 Z-3. R2. P500 F100.\nX5.\nG80\nM30\n"
    assert lines(converted(text, "fanuc", "grbl"))[2:-1] == [
        "G98 G82 Z-3. R2. P500 F100.".join("()"),
        "Z2.", "G1 Z-3. F100.", "G4 P0.5", "G0 Z5.", "(X5.)",
        "X5.", "Z2.", "G1 Z-3.", "G4 P0.5", "G0 Z5.", "G80",
    ]  # fmt: skip


def test_a_pattern_that_is_rotated_has_the_places_of_a_rotation(
    converted: Convert, tmp_path: Path
) -> None:
    text = (
        "G90 G21 G17 G94 G54\nG0 X0. Y0. Z5.\nG68 X10. Y0. R30.\nG0 X20. Y0.\n"
        "G1 X20. Y5. F100.\nG69\nM30\n"
    )
    file = tmp_path / "out.nc"
    file.write_bytes(converted(text, "fanuc", "grbl").text)
    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    wanted = [10.0, 0.0] + (turn @ np.array([[10.0, 0.0], [10.0, 5.0]]).T).T
    np.testing.assert_allclose(moves(file, "grbl")[-2:, :2], wanted, atol=1e-5)


def with_tools(tmp_path: Path, table: str) -> Machine:
    """Return the machine with a tool table."""
    file = tmp_path / "tool.tbl"
    file.write_text(table)
    program = MACHINE.program.model_copy(update={"tool_table": file})
    return MACHINE.model_copy(update={"program": program})


def test_a_tool_length_is_that_of_the_table(tmp_path: Path) -> None:
    file = tmp_path / "in.nc"
    file.write_text("G21 G90\nT1 M6\nG43 H1 G0 Z50.\nX1.\nG49\nZ90.\nM30\n")
    result = convert(str(file), with_tools(tmp_path, "T1 P1 Z12.5 D6\n"), "fanuc", "grbl")
    text = lines(result)
    assert text[text.index("G43.1 Z12.5") + 1] == "G0 Z50."
    assert text[-3:] == ["G49", "Z90.", "M30"]
    assert ("assumed", "lengths of tools are those of the tool table") in result.notes.remarks


def test_a_control_without_offset_numbers_gets_no_g43(converted: Convert) -> None:
    result = converted("G21 G90\nG43 H1 G0 Z50.\nM30\n", "fanuc", "siemens")
    assert b"G43" not in result.text


def test_lines_that_are_left_out_or_may_be_skipped_are_reported(converted: Convert) -> None:
    text = "G21 G90\n/G0 X1.\nG187 P1\nGOTO 9\nG0 X3.\n(note)\nN9 G0 X4.\nM30\nG0 X5.\n"
    remarks = converted(text, "haas", "grbl").notes.remarks
    assert remarks["assumed", "block delete is off: the line is always executed"] == [2]
    assert remarks["left out", "G187 (smoothness of the path)"] == [3]
    assert remarks["left out", "lines that are never executed"] == [5, 9]


def test_cutter_compensation_becomes_the_offset_path(converted: Convert, tmp_path: Path) -> None:
    text = (
        "T1 M6\nG90 G21 G17 G94 G54\nG0 X-20. Y-20.\nG41 D1 G1 X0. Y-10. F100.\n"
        "Y30.\nX40.\nG40 G0 X60. Y50.\nM30\n"
    )
    file = tmp_path / "in.nc"
    file.write_text(text)
    out = tmp_path / "out.nc"
    out.write_bytes(convert(str(file), with_tools(tmp_path, "T1 P1 D6\n"), "linuxcnc", "grbl").text)
    assert b"G41" not in out.read_bytes()
    points = moves(out, "grbl")[:, :2]
    # 3 mm left of X0 going up, and left of Y30 going right.
    assert (
        np.isclose(points, [-3.0, 30.0]).all(axis=1).any() or np.isclose(points[:, 0], -3.0).any()
    )
    assert np.isclose(points[:, 1], 33.0).any()


@pytest.mark.parametrize(("to", "wanted"), [("linuxcnc", "T3 M6"), ("grbl", "M0")])
def test_a_tool_change_is_the_control_s(converted: Convert, to: TargetName, wanted: str) -> None:
    result = converted("G21 G90\nT3\nM6\nG0 X1.\nM30\n", "fanuc", to)
    blocks = "\n".join(lines(result))
    assert wanted in blocks or ("M6" in blocks and "T3" in blocks)
    assert any("by hand" in text for _, text in result.notes.remarks) == (to == "grbl")


def test_a_work_offset_that_the_control_lacks_is_another_one(converted: Convert) -> None:
    result = converted("G21 G90\nG54.1 P3\nG0 X1.\nG54\nX2.\nM30\n", "fanuc", "grbl")
    assert "G59" in result.text.decode()
    assert ("assumed", "G54.1 P3 becomes G59: enter its offset there") in result.notes.remarks


def test_moves_to_zero_are_written_although_the_machine_could_stand_there(
    converted: Convert,
) -> None:
    text = lines(
        converted("G21 G90\nG91 G28 Z0\nG90\nG43 H1 G0 X0. Y0. Z0.\nM30\n", "fanuc", "grbl")
    )
    assert "G53 G0 Z0." in text
    assert any(re.search(r"X0\. Y0\. Z0\.", line) for line in text)


def test_a_spline_becomes_arcs_within_the_tolerance(converted: Convert, tmp_path: Path) -> None:
    text = (
        "G21 G90 G17 G94 G54\nG0 X0 Y0 Z0\nF600\nG5.2 X0 Y10 P1 L3\nX20 Y30 P1\n"
        "X40 Y0 P2\nX50 Y20 P1\nG5.3\nM2\n"
    )
    tolerance = 0.02
    result = converted(text, "linuxcnc", "grbl", tolerance=tolerance)
    assert 0.0 < result.of_curves <= tolerance
    file, source = tmp_path / "out.nc", tmp_path / "in.nc"
    file.write_bytes(result.text)
    source.write_text(text)
    curve = next(
        block for block in parse(source, dialect="linuxcnc") if isinstance(block, NurbsFeed)
    )
    from scipy.interpolate import BSpline

    weights = curve.weights[:, None]
    u = np.linspace(curve.knots[0], curve.knots[-1], 2000)
    bottom = BSpline(curve.knots, weights, curve.degree)(u)
    points = (BSpline(curve.knots, curve.control_points * weights, curve.degree)(u) / bottom)[:, :2]
    start = np.zeros(2)
    nearest = np.full(len(points), np.inf)
    for block in parse(file, dialect="grbl"):
        if isinstance(block, ArcFeed):
            center = np.array(block.center)
            t = np.linspace(0.0, 2.0 * np.pi * block.turns, 400)
            spoke = start - center
            chords = center + np.stack(
                (
                    spoke[0] * np.cos(t) - spoke[1] * np.sin(t),
                    spoke[0] * np.sin(t) + spoke[1] * np.cos(t),
                ),
                1,
            )
            start = block.end[:2]
        elif isinstance(block, Polyline):
            ends = np.concatenate((start[None], block.points[:, :2]))
            chords = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(ends)])
            start = ends[-1]
        else:
            continue
        apart = np.linalg.norm(points[:, None] - chords[None], axis=2).min(axis=1)
        nearest = np.minimum(nearest, apart)
    assert nearest.max() <= tolerance + 0.01  # half the distance of the points on the chords


# Refusals, each at its line


@pytest.mark.parametrize(
    ("text", "dialect", "to", "line", "code"),
    [
        ("G21 G90\nG31 Z-5. F50\n#1=#5063\nG0 X#1\nM30\n", "fanuc", "grbl", 3, "convert-cannot"),
        ("G21 G90 S9 M3\nF99\nG84 X1 Z-5 R2\nM2\n", "linuxcnc", "grbl", 3, "convert-cannot"),
        ("$H\nG0 X1\nM2\n", "grbl", "linuxcnc", 1, "convert-cannot"),
        ("G21 G90\nG96 S100 M3\nM2\n", "linuxcnc", "grbl", 2, "convert-cannot"),
        ("G21 G90\nG0 X1\nM64 P1\nM2\n", "linuxcnc", "grbl", 3, "convert-cannot"),
        ("G21 G90\nG28.1\nM2\n", "grbl", "fanuc", 2, "convert-cannot"),
        ("G21 G90\nG0 X1.\nM51\nM30\n", "haas", "grbl", 3, "convert-cannot"),
        ("G21 G90\nG0 Q1.\nM30\n", "fanuc", "grbl", 2, "word-unused"),
    ],
)  # fmt: skip
def test_what_the_control_cannot_do_is_refused_at_its_line(
    converted: Convert, text: str, dialect: DialectName, to: TargetName, line: int, code: str
) -> None:
    with pytest.raises(CncError) as refused:
        converted(text, dialect, to)
    assert (refused.value.diagnostic.line, refused.value.diagnostic.code) == (line, code)


def test_a_program_that_reads_its_work_offset_is_refused(converted: Convert) -> None:
    with pytest.raises(CncError) as refused:
        converted("G21 G90 G54\nG0 X0.\nG0 X[#5221]\nM30\n", "fanuc", "grbl")
    assert refused.value.diagnostic.code == "convert-differs"


def test_a_program_that_counts_from_where_it_stands_is_refused(converted: Convert) -> None:
    with pytest.raises(CncError) as refused:
        converted("G21 G91 G17 G94\nG81 X1. Z-5. R-2. F100.\nG80\nM30\n", "fanuc", "grbl")
    assert refused.value.diagnostic.code == "convert-differs"


# The proof


@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: text.replace(b"X4.", b"X4.002"),
        lambda text: text.replace(b"F100", b"F101"),
        lambda text: text.replace(b"M8\n", b""),
        lambda text: text.replace(b"I1.", b"I1.002"),
        lambda text: text.replace(b"S900", b"S901"),
        lambda text: text.replace(b"G55", b"G56"),
        lambda text: text.replace(b"M30", b"G0 X9.\nM30"),
        lambda text: text.replace(b"G0 Z9.\n", b""),
        lambda text: text.replace(b"P0.5", b"P0.6"),
        lambda text: text.replace(b"M0", b"M1"),
    ],
)
def test_each_difference_stops_the_conversion(
    converted: Convert, monkeypatch: pytest.MonkeyPatch, spoil: Callable[[bytes], bytes]
) -> None:
    text = (
        "G21 G90 G55\nS900 M3\nM8\nG0 X1. Y2. Z1.\nG1 X2. F100\n"
        "G2 X4. Y2. I1. J0.\nG4 X0.5\nM0\nG0 Z9.\nM30\n"
    )
    good = converted(text, "fanuc", "grbl").text
    assert spoil(good) != good
    proved = programs._Conversion._proved

    def spoiled(self: programs._Conversion, written: writer.Writer) -> tuple[float, float]:
        self._result_path.write_bytes(spoil(good))
        return proved(self, written)

    monkeypatch.setattr(programs._Conversion, "_proved", spoiled)
    with pytest.raises(CncError) as refused:
        converted(text, "fanuc", "grbl")
    assert refused.value.diagnostic.code == "convert-differs"


@pytest.mark.parametrize(
    ("to", "line", "count", "allowed"),
    [("linuxcnc", "X{} Y1.5", 20_000, 10), ("siemens", "G81 X{} Y1.5 Z-1. R2.", 3000, 60)],
    ids=["lines that are kept", "lines that are written anew"],
)
def test_the_memory_does_not_grow_with_the_program(
    to: TargetName,
    line: str,
    count: int,
    allowed: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The text has 9 bytes a line; an entry of a list for each line takes over 100."""
    monkeypatch.setattr(source_text, "WINDOW_BYTES", 1 << 13)
    peaks = []
    sizes = share((count, count, 3 * count), (count // 10, count, 2 * count))
    for lines_ in sizes:
        file = tmp_path / "long.nc"
        moves = "\n".join(line.format(number % 500 / 10) for number in range(lines_))
        file.write_text(f"G21 G90 G17\nG0 X60. Y1.5 Z1.\nG1 X50. F900.\n{moves}\nM30\n")
        del moves
        gc.collect()  # a collection at another moment changes the peak by half a megabyte
        tracemalloc.start()
        with tempfile.TemporaryFile() as into:
            result = convert(str(file), MACHINE, "fanuc", to, into=into)
            assert result.lines >= lines_
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] < peaks[1] + allowed * (sizes[2] - sizes[1]), peaks


def test_dwells_and_stops_are_in_their_units(converted: Convert, tmp_path: Path) -> None:
    file = tmp_path / "out.nc"
    for to in ("grbl", "linuxcnc", "haas", "siemens", "marlin", "mach3"):
        file.write_bytes(converted("G21 G90\nG0 X1.\nG4 P1500\nM0\nM30\n", "fanuc", to).text)
        blocks = list(parse(file, dialect=to))
        assert [block.seconds for block in blocks if isinstance(block, Dwell)] == [1.5]
        assert sum(isinstance(block, Stop) for block in blocks) == 1


# Programs of all styles

PROBES = {"fanuc-probing", "linuxcnc-probing"}
"""Styles that decide by the answer of a probe."""


@pytest.mark.parametrize("style", sorted(STYLES)[:: share(1, 4)])
@pytest.mark.parametrize("to", ["grbl", "linuxcnc"])
def test_programs_of_all_styles_are_written(tmp_path: Path, style: str, to: TargetName) -> None:
    for seed in range(share(10, 1)):
        file = tmp_path / "program.nc"
        text = STYLES[style](random.Random(f"convert {style} {seed}"))
        file.write_bytes(text.encode(errors="surrogateescape"))
        code = ""
        try:
            result = convert(str(file), MACHINE, None, to)
            assert result.distance <= 1e-3
            assert result.of_curves <= 0.01
        except CncError as error:
            code = error.diagnostic.code
        assert code != "convert-differs"
        is_for_board = EXPECTED[style] == "grbl" and to == "linuxcnc"
        assert code != "convert-cannot" or style in PROBES or is_for_board


# Short moves as curves


def test_short_moves_become_arcs_and_corners_stay(converted: Convert, tmp_path: Path) -> None:
    angles = np.linspace(0.0, np.pi, 181)
    half = [f"X{20 - 20 * np.cos(a):.4f} Y{20 * np.sin(a):.4f}" for a in angles[1:]]
    back = [f"X{40 - step / 5:.4f} Y0" for step in range(1, 201)]
    text = "\n".join(
        ["G21 G90 G17 G94 G54", "G0 X0 Y0 Z0", "F600", "G1 " + half[0], *half[1:], *back, "M2"]
    )
    result = converted(text, "linuxcnc", "grbl", curves="arcs")
    assert len(lines(result)) <= 12
    assert 0.0 < result.of_curves <= 0.01
    file = tmp_path / "out.nc"
    file.write_bytes(result.text)
    assert np.isclose(moves(file, "grbl")[:, :2], [40.0, 0.0], atol=1e-4).all(axis=1).any()


def finishing(seed: int, rows: int, *, planar: bool) -> list[str]:
    """Return a pass over a wavy surface, or over a plane, in chords of 0.15 mm."""
    rng = np.random.default_rng(seed)
    size, phase, wave = (
        rng.uniform(0.3, 2.0, 2),
        rng.uniform(0.0, 6.0, 2),
        rng.uniform(0.05, 0.25, 2),
    )
    text = ["G21 G90 G17 G94 G54", "G0 X0 Y0 Z5", "F1500", "G1"]
    for row in range(rows):
        x = 0.15 * np.arange(400)[:: (-1) ** row]
        bend = size[0] * np.sin(wave[0] * x + phase[0]) + size[1] * np.cos(wave[1] * x + phase[1])
        y, z = (3.0 * row + bend, 0.0 * x) if planar else (0.3 * row + 0.02 * x, bend)
        text += [f"X{a:.4f} Y{b:.4f} Z{c:.4f}" for a, b, c in zip(x, y, z, strict=True)]
    return [*text, "G0 Z5", "M2"]


def distances(points: np.ndarray, chords: np.ndarray) -> np.ndarray:
    """Return the distance of points from a chain of chords, by brute force."""
    begins, steps = chords[:-1], np.diff(chords, axis=0)
    keep = np.einsum("ij,ij->i", steps, steps) > 0.0
    begins, steps = begins[keep], steps[keep]
    nearest = []
    for point in points:
        apart = point - begins
        share = np.einsum("ij,ij->i", apart, steps) / np.einsum("ij,ij->i", steps, steps)
        apart -= np.clip(share, 0.0, 1.0)[:, None] * steps
        nearest.append(np.sqrt(np.einsum("ij,ij->i", apart, apart).min()))
    return np.array(nearest)


@pytest.mark.parametrize(
    ("to", "planar", "fewer"),
    [("fanuc", False, 9.0), ("siemens", False, 10.0), ("linuxcnc", True, 10.0)],
)
def test_short_moves_become_nurbs_within_the_tolerance(
    converted: Convert, tmp_path: Path, to: TargetName, planar: bool, fewer: float
) -> None:
    """The curve of the result is evaluated by scipy, and measured by brute force."""
    from scipy.interpolate import BSpline

    text = finishing(share(int(np.random.default_rng().integers(1000)), 1), 3, planar=planar)
    result = converted("\n".join(text), "linuxcnc", to, curves="nurbs", tolerance=0.01)
    assert len(lines(result)) < len(text) / fewer
    file, source = tmp_path / "out.nc", tmp_path / "in.nc"
    file.write_bytes(result.text)
    source.write_text("\n".join(text))
    program = moves(source, "linuxcnc")[1:-1]
    traced = [program[:1]]
    for block in parse(file, dialect=to):
        if isinstance(block, NurbsFeed):
            assert (block.weights == 1.0).all()
            u = np.linspace(block.knots[0], block.knots[-1], 40 * len(block.knots))
            traced.append(BSpline(block.knots, block.control_points, block.degree)(u))
        elif isinstance(block, Polyline):
            traced.append(block.points)
        elif isinstance(block, ArcFeed):
            traced.append(block.end[None])
    chords = np.concatenate(traced)
    some = program[:: share(1, 7)]
    assert distances(some, chords[: len(chords)]).max() <= 0.01 + 1e-4
    assert 0.0 < result.of_curves <= 0.01


def test_corners_between_nurbs_stay(converted: Convert, tmp_path: Path) -> None:
    """Two half circles of chords meet at a right angle and at a straight move."""
    angles = np.linspace(np.pi, 0.0, 200)
    first = [(20 + 20 * np.cos(a), 20 * np.sin(a)) for a in angles]
    second = [(40 + 20 + 20 * np.cos(a), 20 * np.sin(a)) for a in angles]
    text = ["G21 G90 G17 G94 G54", "G0 X0 Y0 Z0", "F600", "G1 X0.001 Y0"]
    text += [f"X{x:.4f} Y{y:.4f}" for x, y in [*first[1:], *second[1:], (100.0, 0.0)]]
    result = converted("\n".join([*text, "M2"]), "linuxcnc", "fanuc", curves="nurbs")
    file = tmp_path / "out.nc"
    file.write_bytes(result.text)
    ends = [
        block.control_points[-1]
        for block in parse(file, dialect="fanuc")
        if isinstance(block, NurbsFeed)
    ]
    for corner in (first[-1], second[-1]):
        assert min(float(np.hypot(*(end[:2] - corner))) for end in ends) < 1e-4


def test_a_control_without_nurbs_is_told(converted: Convert) -> None:
    for to in ("grbl", "haas", "mach3", "marlin"):
        with pytest.raises(CncError) as refused:
            converted("G21 G90\nG1 X1 F100\nM2\n", "linuxcnc", to, curves="nurbs")
        assert refused.value.diagnostic.code == "convert-no-nurbs"


# The command


def test_the_command_writes_the_file_and_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out, report = tmp_path / "a.nc", tmp_path / "b.nc", tmp_path / "r.json"
    file.write_text("O0001\nG21 G90\nG0 X1.\nM30\n")
    arguments = ["convert", str(file), "--dialect", "fanuc", "--to", "grbl", "-o", str(out)]
    assert exit_code([*arguments, "--json", str(report)]) == 0
    assert "G0 X1." in out.read_text()
    assert "fanuc -> grbl" in capsys.readouterr().err
    values = json.loads(report.read_text())
    assert (values["source"], values["target"], values["distance_mm"]) == ("fanuc", "grbl", 0.0)


def test_the_result_goes_to_standard_output(
    tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    file = tmp_path / "a.nc"
    file.write_text("G21 G90\nG0 X1.\nM30\n")
    assert exit_code(["convert", str(file), "--to", "grbl", "--quiet"]) == 0
    written = capsysbinary.readouterr()
    assert written.out.endswith(b"G0 X1.\nM30\n")
    assert written.err == b""


def test_the_program_itself_is_replaced_only_in_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.nc"
    text = "G21 G90\nG0 X1.\nM6 T1\nM30\n"
    file.write_text(text)
    assert exit_code(["convert", str(file), "--to", "grbl", "-o", str(file)]) == 2
    assert "output-over-input" in capsys.readouterr().err
    assert file.read_text() == text
    assert exit_code(["convert", str(file), "--to", "grbl", "--in-place"]) == 0
    assert "M0" in file.read_text()
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    "arguments",
    [
        ["-", "--to", "grbl", "--in-place"],
        ["a.nc", "--to", "grbl", "--in-place", "-o", "b.nc"],
        ["a.nc", "--to", "heidenhain"],
        ["a.nc"],
        ["a.nc", "--to", "grbl", "--tolerance", "0"],
        ["missing.nc", "--to", "grbl"],
    ],
)
def test_wrong_usage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.nc").write_text("G0 X1\nM30\n")
    assert exit_code(["convert", *arguments]) == 2
    assert not Path("b.nc").exists()


def test_a_refused_program_leaves_the_old_file(tmp_path: Path) -> None:
    file, out = tmp_path / "a.nc", tmp_path / "b.nc"
    file.write_text("G21 G90\nG28.1\nM2\n")
    out.write_text("old")
    assert (
        exit_code(["convert", str(file), "--dialect", "grbl", "--to", "fanuc", "-o", str(out)]) == 1
    )
    assert out.read_text() == "old"
    assert sorted(tmp_path.iterdir()) == [file, out]


@pytest.mark.parametrize(("to", "curves"), [("grbl", "lines"), ("siemens", "nurbs")])
def test_boards_and_curves_are_not_for_lathes(
    to: TargetName, curves: Curves, tmp_path: Path
) -> None:
    file = tmp_path / "a.nc"
    file.write_text("G0 X1\nM30\n")
    lathe = MACHINE.model_copy(update={"kind": "lathe"})
    with pytest.raises(CncError) as refused:
        programs.convert(str(file), lathe, None, to, curves=curves)
    assert refused.value.diagnostic.code == "convert-lathe"

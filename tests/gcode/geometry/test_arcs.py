"""Arc geometry against independent formulas, and the tolerance of each dialect."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode import dialects
from cnc.gcode.core import arcs
from cnc.gcode.reader.words import Word
from cnc.model.blocks import ArcFeed
from tests.support.gcode.gcode_cases import error_of, run

WORD = Word("I", 0.0, "I0", 1, 2)
MM = dialects.load("linuxcnc").arcs.mm


def point(center: complex, radius: float, angle: float) -> tuple[float, float]:
    at = center + cmath.rect(radius, angle)
    return at.real, at.imag


@given(
    st.complex_numbers(max_magnitude=100, allow_nan=False),
    st.floats(0.1, 500),
    st.floats(0, math.tau),
    st.floats(1e-4, math.tau - 1e-4),
    st.booleans(),
)
def test_the_centre_format_sweeps_the_angle(
    center: complex, radius: float, angle: float, sweep: float, clockwise: bool
) -> None:
    start, end = (
        point(center, radius, angle),
        point(center, radius, angle - sweep if clockwise else angle + sweep),
    )
    arc = arcs.from_center(
        start,
        end,
        (center.real, center.imag),
        clockwise=clockwise,
        turns=1,
        tolerance=MM,
        word=WORD,
    )
    assert arc.turns * math.tau == pytest.approx(-sweep if clockwise else sweep, abs=1e-9)
    assert arc.length(3.0) == pytest.approx(math.hypot(radius * sweep, 3.0), rel=1e-9)


@given(
    st.complex_numbers(max_magnitude=100, allow_nan=False),
    st.floats(0.5, 500),
    st.floats(0, math.tau),
    st.floats(0.01, math.tau - 0.01).filter(lambda sweep: abs(sweep - math.pi) > 0.01),
    st.booleans(),
)
def test_the_radius_format_finds_the_centre(
    center: complex, radius: float, angle: float, sweep: float, clockwise: bool
) -> None:
    start, end = (
        point(center, radius, angle),
        point(center, radius, angle - sweep if clockwise else angle + sweep),
    )
    given_radius = -radius if sweep > math.pi else radius
    arc = arcs.from_radius(
        start, end, given_radius, clockwise=clockwise, turns=1, tolerance=MM, word=WORD
    )
    assert math.dist(arc.center, (center.real, center.imag)) < 1e-6
    assert arc.turns * math.tau == pytest.approx(-sweep if clockwise else sweep, abs=1e-6)


# end point of a half circle about X5 (radius 5) at X10 + d: the radii differ by d.
# linuxcnc: refused above 0.02828 mm and 0.1 %; grbl: above 0.005 mm and 0.1 %, or above 0.5 mm
@pytest.mark.parametrize(
    ("dialect", "radius", "off", "good"),
    [
        ("linuxcnc", 5, 0.028, True),
        ("linuxcnc", 5, 0.029, False),
        ("linuxcnc", 100, 0.09, True),
        ("linuxcnc", 100, 0.11, False),
        ("linuxcnc", 10_000, 2.8, True),
        ("linuxcnc", 10_000, 2.9, False),
        ("grbl", 1, 0.0049, True),
        ("grbl", 1, 0.0051, False),
        ("grbl", 100, 0.09, True),
        ("grbl", 100, 0.11, False),
        ("grbl", 10_000, 0.49, True),
        ("grbl", 10_000, 0.51, False),
        ("auto", 5, 0.029, False),
        ("fanuc", 5, 0.028, True),
    ],
)
def test_the_tolerance_of_the_radius(dialect: str, radius: float, off: float, good: bool) -> None:
    source = f"G2 X{2 * radius + off} I{radius} F60\nM2"
    if good:
        block, _ = run(source, dialect=dialect)
        assert isinstance(block, ArcFeed)
        assert block.radius == radius
        assert block.end[0] == 2 * radius + off
    else:
        assert error_of(source, dialect=dialect).code == "arc-radius-mismatch"


def test_the_tolerance_is_wider_in_inches() -> None:
    assert run("G20\nG2 X1.0028 I.5 F60")
    assert error_of("G20\nG2 X1.003 I.5 F60").code == "arc-radius-mismatch"


@pytest.mark.parametrize(("end", "good"), [(10.0025, True), (10.0026, False)])
def test_the_tolerance_of_r(end: float, good: bool) -> None:
    """0.00127 mm of half the chord."""
    if good:
        (block,) = run(f"G3 X{end} R5 F60")
        assert isinstance(block, ArcFeed)
        assert block.turns == 0.5
        assert block.radius == pytest.approx(end / 2)
    else:
        assert error_of(f"G3 X{end} R5 F60").code == "arc-radius-too-small"


def test_turns_of_a_nearly_closed_arc() -> None:
    (block,) = run("G3 X0.00000005 I5 F60")
    assert isinstance(block, ArcFeed)
    assert block.turns == 1.0
    (block,) = run("G3 X0 Y0.001 I-5 F60")
    assert isinstance(block, ArcFeed)
    assert block.turns == pytest.approx(0.001 / 5 / math.tau, rel=1e-6)
    (block,) = run("G3 X0 Y-0.001 I-5 F60")
    assert isinstance(block, ArcFeed)
    assert block.turns == pytest.approx(1 - 0.001 / 5 / math.tau, rel=1e-9)


@pytest.mark.parametrize("dialect", ["auto", "grbl", "fanuc"])
@pytest.mark.parametrize(
    "words",
    ["G17\nG2 X2. Y0. I1. J0. K0.", "G18\nG2 X2. Z0. I1. J0. K0.", "G19\nG2 Y2. Z0. I0. J1. K0."],
)
def test_a_centre_word_of_0_across_the_plane(dialect: str, words: str) -> None:
    before, line = words.split("\n")
    (found,) = (
        block
        for block in run(f"{before}\nF60\n{line}\nM2", dialect=dialect)
        if isinstance(block, ArcFeed)
    )
    idle = {"G17": " K0.", "G18": " J0.", "G19": " I0."}[before]
    (plain,) = (
        block
        for block in run(f"{before}\nF60\n{line.replace(idle, '')}\nM2", dialect=dialect)
        if isinstance(block, ArcFeed)
    )
    assert (found.center, list(found.end), found.turns) == (
        plain.center,
        list(plain.end),
        plain.turns,
    )


@pytest.mark.parametrize(
    ("dialect", "word"), [("linuxcnc", "K0"), ("auto", "K0.5"), ("grbl", "K0.5"), ("fanuc", "K.5")]
)
def test_a_centre_word_across_the_plane_is_refused(dialect: str, word: str) -> None:
    fault = error_of(f"F60\nG2 X2. Y0. I1. J0. {word}\nM2", dialect=dialect)
    assert (fault.code, fault.line, fault.column) == ("word-unused", 2, 20)

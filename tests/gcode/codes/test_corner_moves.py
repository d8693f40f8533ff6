"""Chamfers and rounds at arcs in programs (,C and ,R)."""

from __future__ import annotations

import math

import pytest

from cnc.model.blocks import ArcFeed, Block, Polyline
from tests.support.gcode.gcode_cases import error_of, run

START = "G90 G17 G0 X0 Y0\n"


def ends(blocks: list[Block]) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    for block in blocks:
        if isinstance(block, Polyline):
            found += [(x, y) for x, y, *_ in block.points.tolist()]
        elif isinstance(block, ArcFeed):
            found.append((float(block.end[0]), float(block.end[1])))
    return found


def arcs(blocks: list[Block]) -> list[ArcFeed]:
    return [block for block in blocks if isinstance(block, ArcFeed)]


def is_smooth(start: tuple[float, float], block: ArcFeed) -> bool:
    """Whether an arc ends where its centre and turns say."""
    ray = complex(*start) - complex(*block.center)
    turned = ray * complex(math.cos(math.tau * block.turns), math.sin(math.tau * block.turns))
    return abs(complex(*block.center) + turned - complex(*block.end[:2])) < 1e-9


def test_a_round_between_a_line_and_an_arc() -> None:
    blocks = run(f"{START}G1 X10 F60 ,R2\nG3 X0 Y10 I-10 J0", dialect="fanuc")
    x = math.sqrt(60.0)
    reached = ends(blocks)
    assert reached[1:] == [
        pytest.approx((x, 0.0)), pytest.approx((x * 1.25, 2.5)), pytest.approx((0.0, 10.0))
    ]  # fmt: skip
    first, second = arcs(blocks)
    assert first.radius == 2.0
    assert second.radius == 10.0
    assert is_smooth(reached[1], first)
    assert is_smooth(reached[2], second)


def test_the_way_back_is_the_same() -> None:
    """The mirror image of the round before an arc is the round after one."""
    blocks = run("G90 G17 G0 X0 Y10\nG2 X10 Y0 J-10 F60 ,R2\nG1 X0", dialect="fanuc")
    forth = run(f"{START}G1 X10 F60 ,R2\nG3 X0 Y10 I-10 J0", dialect="fanuc")
    back = [pytest.approx(end) for end in reversed(ends(forth))]
    assert ends(blocks) == back


def test_rounds_and_chamfers_in_a_row() -> None:
    blocks = run(f"{START}G1 X10 F60 ,R1\nG2 X20 I5 ,R1\nG1 X30 ,C1\nY10", dialect="fanuc")
    reached = ends(blocks)
    assert reached[-3:] == [(29.0, 0.0), (30.0, 1.0), (30.0, 10.0)]
    round_before, half, round_after = arcs(blocks)
    assert round_before.turns == pytest.approx(round_after.turns)
    assert half.turns == pytest.approx(-0.5 + 2 * (math.asin(1 / 6) / math.tau))
    for start, block in zip(reached[1:], (round_before, half, round_after), strict=False):
        assert is_smooth(start, block)


@pytest.mark.parametrize("dialect", ["haas", "siemens"])
def test_other_controllers_have_no_chamfers_at_arcs(dialect: str) -> None:
    word = "CHR=2" if dialect == "siemens" else ",C2."
    found = error_of(f"{START}G1 X10. F60. {word}\nG3 X0. Y10. I-10.", dialect=dialect)
    assert found.code == "corner-next"


def test_a_chamfer_at_an_arc_begins_at_a_straight_distance_from_the_corner() -> None:
    """Of a circle of radius 10 a chord of 2 spans 2 asin(0.1)."""
    blocks = run(f"{START}G1 X10 F60 ,C2\nG3 X0 Y10 I-10 ,C2\nG1 Y15", dialect="fanuc")
    angle = 2.0 * math.asin(0.1)
    begin = 10.0 * math.cos(angle), 10.0 * math.sin(angle)
    assert ends(blocks)[1:] == [
        pytest.approx((8.0, 0.0)), pytest.approx(begin), pytest.approx((begin[1], begin[0])),
        pytest.approx((0.0, 12.0)), (0.0, 15.0),
    ]  # fmt: skip
    (arc,) = arcs(blocks)
    assert is_smooth(begin, arc)
    assert arc.turns == pytest.approx(0.25 - 2.0 * angle / math.tau)


def test_the_angle_of_a_line_completes_its_end() -> None:
    blocks = run(f"{START}G1 X10 ,A30 F60 ,R1\nY20 ,A120", dialect="fanuc")
    y = 10.0 * math.tan(math.radians(30.0))
    x = 10.0 - (20.0 - y) / math.tan(math.radians(60.0))
    assert ends(blocks)[-1] == pytest.approx((x, 20.0))
    (arc,) = arcs(blocks)
    assert (arc.radius, arc.turns) == (1.0, pytest.approx(0.25))


@pytest.mark.parametrize(
    ("source", "code", "line"),
    [
        ("G2 X10 I5 F60 ,C11\nG1 X20", "corner-too-large", 2),
        ("G1 X10 F60 ,C2\nG3 X10 Y10 J5", "corner-too-large", 2),
        ("G1 X10 F60 ,R2\nG0 X0", "corner-next", 2),
        ("G1 X10 F60 ,R20\nG3 X0 Y10 I-10", "corner-too-large", 2),
        ("G1 X10 F60 ,R2\nG3 X20 Y10 J10", "corner-too-large", 2),
        ("G1 X10 F60 ,R2\nG3 X0 Y10 Z5 I-10", "corner-plane", 2),
        ("G2 X10 I5 F60 ,R1", "corner-next", 2),
    ],
)
def test_faults(source: str, code: str, line: int) -> None:
    found = error_of(START + source, dialect="fanuc")
    assert (found.code, found.line) == (code, line)


def test_haas_rounds_corners_of_lines_only() -> None:
    found = error_of(f"{START}G1 X10 F60 ,R2\nG3 X0 Y10 I-10", dialect="haas")
    assert found.code == "corner-next"
    assert len(arcs(run(f"{START}G1 X10 F60 ,R2\nY10", dialect="haas"))) == 1

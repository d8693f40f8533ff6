"""Shapes of tools by the words of their comments."""

import math

import pytest

from cnc.stock.kernels.sweep import BALL, BULL, CONE, FLAT, height
from cnc.stock.simulation import tool_shape


def cone(angle):
    return pytest.approx(1.0 / math.tan(math.radians(angle) / 2.0))


@pytest.mark.parametrize(
    ("comment", "expected", "is_assumed"),
    [
        ("D=6. CR=0. - ZMIN=-5. - flat end mill", (FLAT, 3.0, 3.0, 0.0), False),
        ("6 mm 2-flute endmill", (FLAT, 3.0, 3.0, 0.0), False),
        ("ball end mill", (BALL, 3.0, 0.0, 3.0), False),
        ("BALLNOSE 6MM", (BALL, 3.0, 0.0, 3.0), False),
        ("D=6. CR=3. - ball end mill", (BALL, 3.0, 0.0, 3.0), False),
        ("D=6. CR=1. - bullnose end mill", (BULL, 3.0, 2.0, 1.0), False),
        ("corner radius 0.5", (BULL, 3.0, 2.5, 0.5), False),
        ("bull nose", (FLAT, 3.0, 3.0, 0.0), True),
        ("D=6. CR=0. TAPER=118deg - drill", (CONE, 3.0, 0.0, cone(118.0)), False),
        ("D=6. CR=0. TAPER=45deg - chamfer mill", (CONE, 3.0, 0.0, cone(90.0)), False),
        ("drill 6 mm", (CONE, 3.0, 0.0, cone(118.0)), True),
        ("spot drill", (CONE, 3.0, 0.0, cone(90.0)), True),
        ("60 deg V-bit", (CONE, 3.0, 0.0, cone(60.0)), False),
        ("V60", (CONE, 3.0, 0.0, cone(60.0)), False),
        ("engraver 30° tip 0.2", (CONE, 3.0, 0.1, cone(30.0)), False),
        ("v-bit", (FLAT, 3.0, 3.0, 0.0), True),
        ("", (FLAT, 3.0, 3.0, 0.0), True),
        ("my best tool", (FLAT, 3.0, 3.0, 0.0), True),
    ],
)
def test_shapes_by_their_words(comment, expected, is_assumed):
    found = tool_shape(6.0, comment)
    assert tuple(found.assembly.cutter) == expected
    assert bool(found.assumed) == is_assumed


def test_lengths_of_flutes_and_holder():
    found = tool_shape(6.0, "flat FL=20 holder 40x35").assembly
    assert (found.flutes, found.holder, found.stickout) == (20.0, 20.0, 35.0)
    found = tool_shape(6.35, "flat LOC 0.75 holder 1x2", scale=25.4).assembly
    assert (found.flutes, found.holder, found.stickout) == pytest.approx((19.05, 12.7, 50.8))
    found = tool_shape(6.0, "flat").assembly
    assert (found.flutes, found.stickout) == (math.inf, math.inf)


def test_a_tool_without_a_diameter_is_said():
    assert "no diameter" in tool_shape(0.0, "ball").assumed


def test_heights_of_the_shapes():
    assert height(tool_shape(6.0, "ball").assembly.cutter, 3.0) == 3.0
    assert height(tool_shape(6.0, "CR=1").assembly.cutter, 2.0) == 0.0
    assert height(tool_shape(6.0, "CR=1").assembly.cutter, 3.0) == 1.0
    assert height(tool_shape(6.0, "90 deg").assembly.cutter, 3.0) == pytest.approx(3.0)

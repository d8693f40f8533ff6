"""Coordinate systems: values computed by formula, and properties with random offsets."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode.core.coordinates import EXTERNAL, Coordinates, bind_position
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.words import G

XYZ = ("x", "y", "z")
ROOT = math.sqrt(3.0) / 2.0
NUMBERS = st.floats(-1000, 1000)


def fresh(
    values: dict[int, float] | None = None, axes: tuple[str, ...] = XYZ, **options: bool
) -> Coordinates:
    return Coordinates(axes, Parameters(values), **options)


def test_no_offsets_no_change() -> None:
    plain = fresh()
    assert plain.zero == [0.0, 0.0, 0.0]
    assert plain.to_machine([1.0, 2.0, 3.0]) == [1.0, 2.0, 3.0] == plain.to_program([1.0, 2.0, 3.0])


def test_all_offsets_together() -> None:
    """machine = tool + origin + R(30) (program + shift), worked out by hand."""
    place = fresh()
    place.set_origin(0, {0: 100.0, 1: 200.0, 2: 300.0}, rotation=30.0)
    place.set_local({0: 4.0, 2: 6.0})
    place.tool_offset = [0.5, 0.0, 40.0]
    x, y = 6.0 + 4.0, 8.0
    assert place.to_machine([6.0, 8.0, 1.0]) == pytest.approx(
        [100.5 + ROOT * x - 0.5 * y, 200.0 + 0.5 * x + ROOT * y, 347.0], rel=1e-15
    )
    assert place.rotated([2.0, 0.0, 7.0]) == pytest.approx([2.0 * ROOT, 1.0, 7.0], rel=1e-15)


@pytest.mark.parametrize(
    ("angle", "x", "y"),
    [(90, -2, 1), (180, -1, -2), (-90, 2, -1), (270, 2, -1), (360, 1, 2), (-450, 2, -1)],
)
def test_quarter_turns_are_exact(angle: float, x: float, y: float) -> None:
    place = fresh()
    place.set_origin(0, {}, rotation=angle)
    assert place.to_machine([1.0, 2.0, 3.0]) == [x, y, 3.0]
    assert place.to_program([x, y, 3.0]) == [1.0, 2.0, 3.0]


def test_rotary_and_additional_axes_are_not_rotated() -> None:
    place = fresh(axes=("c", "y", "u", "x"))
    place.set_origin(0, {}, rotation=90.0)
    assert place.to_machine([7.0, 2.0, 8.0, 1.0]) == [7.0, 1.0, 8.0, -2.0]


def test_a_machine_without_y_has_no_rotation() -> None:
    place = fresh({5230: 90.0}, axes=("x", "z"))
    assert not place.can_rotate
    assert place.to_machine([1.0, 2.0]) == [1.0, 2.0]


def test_stored_values_are_in_effect_from_the_start() -> None:
    place = fresh({5220: 3.0, 5261: 10.0, 5263: 30.0, 5270: 90.0, 5210: 1.0, 5211: 1.0, 5212: 2.0})
    assert place.system == 2
    assert place.to_machine([0.0, 0.0, 0.0]) == [10.0 - 2.0, 1.0, 30.0]


@pytest.mark.parametrize("number", [0.0, 10.0, 2.5, -1.0, math.nan])
def test_an_invalid_stored_system_is_the_first(number: float) -> None:
    assert fresh({5220: number}).system == 0


def test_a_stored_shift_needs_its_flag() -> None:
    place = fresh({5210: 0.0, 5211: 5.0})
    assert place.zero == [0.0, 0.0, 0.0]
    place.restore_shift()
    assert place.zero == [5.0, 0.0, 0.0]
    assert place.parameters.values[5210] == 1.0


def test_an_assigned_value_takes_effect_at_the_next_selection() -> None:
    place = fresh()
    place.parameters.values[5221] = 10.0
    place.select(0)
    assert place.zero == [0.0, 0.0, 0.0]
    place.select(1)
    place.select(0)
    assert place.zero == [10.0, 0.0, 0.0]
    place.parameters.values[5222] = 20.0
    place.set_origin(1, {0: 1.0})
    assert place.zero == [10.0, 0.0, 0.0]
    place.set_origin(0, {2: 30.0})
    assert place.zero == [10.0, 20.0, 30.0]


def test_the_system_in_use_is_stored() -> None:
    place = fresh()
    place.select(8)
    assert place.parameters.values[5220] == 9.0
    place.end()
    assert (place.system, place.parameters.values[5220]) == (0, 1.0)


def test_numbers_of_each_system() -> None:
    place = fresh(axes=("x", "y", "z", "a", "b", "c", "u", "v", "w"))
    place.set_origin(8, dict(enumerate(range(1, 10))), rotation=15.0)
    assert [place.parameters.values[number] for number in range(5381, 5391)] == [
        1,
        2,
        3,
        4,
        5,
        6,
        7,
        8,
        9,
        15,
    ]


def test_origin_here_under_a_rotation_keeps_the_other_coordinate() -> None:
    """Machine (10, 20) under R90 is program (20, -10); G10 L20 X5 keeps Y -10: origin = (10, 20) -
    R90 (5, -10) = (0, 15).
    """
    place = fresh()
    place.set_origin(0, {}, rotation=90.0)
    place.set_origin_here(0, {0: 5.0}, [10.0, 20.0, 0.0])
    assert place.to_program([10.0, 20.0, 0.0]) == [5.0, -10.0, 0.0]
    assert [place.parameters.values[5221], place.parameters.values[5222]] == [0.0, 15.0]


def test_origin_here_of_another_system_uses_its_rotation() -> None:
    place = fresh()
    place.set_origin(1, {0: 3.0}, rotation=180.0)
    place.set_shift_here({0: 0.0}, [2.0, 0.0, 0.0])
    place.set_origin_here(1, {0: 7.0, 2: 1.0}, [10.0, 20.0, 5.0])
    place.select(1)
    assert place.to_program([10.0, 20.0, 5.0]) == [7.0, -20.0, 1.0]


def test_shift_here_under_a_rotation() -> None:
    """Machine (10, 20) under R90 is program (20, -10); G92 X1 shifts by 19 along program X, which
    is machine Y.
    """
    place = fresh()
    place.set_origin(0, {}, rotation=90.0)
    place.set_shift_here({0: 1.0}, [10.0, 20.0, 0.0])
    assert [place.parameters.values[number] for number in (5210, 5211, 5212)] == [1.0, 19.0, 0.0]
    assert place.to_machine([0.0, 0.0, 0.0]) == [0.0, 19.0, 0.0]


def test_suspend_and_restore() -> None:
    place = fresh()
    place.set_shift_here({0: 0.0, 1: 0.0}, [3.0, 4.0, 0.0])
    place.suspend_shift()
    assert place.zero == [0.0, 0.0, 0.0]
    place.restore_shift()
    assert place.zero == [3.0, 4.0, 0.0]
    place.suspend_shift()
    place.set_local({2: 1.0})  # starts from what is in effect, not from what is stored
    assert place.zero == [0.0, 0.0, 1.0]
    place.clear_shift()
    place.restore_shift()
    assert place.zero == [0.0, 0.0, 0.0]


def test_local_offset() -> None:
    place = fresh(fanuc=True)
    place.set_shift_here({0: 0.0}, [10.0, 0.0, 0.0])
    place.set_local({0: 1.0, 1: 2.0})
    assert place.zero == [11.0, 2.0, 0.0]
    place.select(1)
    assert place.zero == [11.0, 2.0, 0.0]  # in every coordinate system
    place.set_shift_here({0: 5.0}, [10.0, 0.0, 0.0])  # ends it on the axes given
    assert place.zero == [5.0, 2.0, 0.0]
    place.end()
    assert place.zero == [5.0, 0.0, 0.0]


def test_external_offset_is_added_to_every_system() -> None:
    place = fresh(fanuc=True)
    place.set_origin(1, {0: 100.0})
    place.set_origin(EXTERNAL, {0: 1.0, 2: 3.0})
    assert place.zero == [1.0, 0.0, 3.0]
    place.select(1)
    assert place.zero == [101.0, 0.0, 3.0]


def test_tool_for_under_a_rotation_keeps_the_other_direction() -> None:
    """The old offset's Y in program directions stays; X makes the coordinate 5."""
    place = fresh()
    place.set_origin(0, {}, rotation=90.0)
    # Machine (-2, 1) is program (1, 2). Tool (2.54, 0) is (0, -2.54) in program directions; its X
    # becomes 1 - 5.
    tool = place.tool_for([2.54, 0.0, 12.7], {0: 5.0}, [-2.0, 1.0, 3.0])
    assert tool == {0: 2.54, 1: -4.0}


def test_tool_for_a_fixture_ignores_the_shift() -> None:
    place = fresh()
    place.set_origin(8, {2: 2.0})
    place.set_shift_here({2: 0.0}, [0.0, 0.0, 50.0])
    assert place.tool_for([0.0, 0.0, 0.0], {2: 1.0}, [0.0, 0.0, 8.0], fixture=True) == {2: 5.0}
    assert place.tool_for([0.0, 0.0, 0.0], {2: 1.0}, [0.0, 0.0, 58.0]) == {2: 7.0}


def test_home_positions() -> None:
    place = fresh({5163: 9.0})
    assert place.home(G.G28) == [0.0, 0.0, 9.0]
    place.set_home(G.G30, [1.0, 2.0, 3.0])
    assert [place.parameters.values[number] for number in (5181, 5182, 5183)] == [1.0, 2.0, 3.0]
    assert place.home(G.G30) == [1.0, 2.0, 3.0]


def test_position_parameters() -> None:
    place = fresh(axes=("x", "z", "a"))
    place.set_origin(0, {0: 25.4, 2: 90.0})
    bind_position(place, lambda: [50.8, 25.4, 100.0], lambda: 25.4)
    parameters = place.parameters
    assert [parameters.number(5420 + n, 1) for n in range(9)] == [
        1.0,
        0.0,
        1.0,
        10.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    ]
    assert [parameters.name(name, 1) for name in ("_x", "_z", "_a", "_b", "_abs_x", "_abs_a")] == [
        1.0,
        1.0,
        10.0,
        0.0,
        2.0,
        100.0,
    ]
    place.select(6)
    assert parameters.name("_coord_system", 1) == 591.0


POINTS = st.lists(NUMBERS, min_size=3, max_size=3)


@given(POINTS, POINTS, POINTS, POINTS, st.floats(-720, 720))
def test_conversion_round_trip(
    point: list[float], origin: list[float], shift: list[float], tool: list[float], angle: float
) -> None:
    place = fresh()
    place.set_origin(0, dict(enumerate(origin)), rotation=angle)
    place.set_local(dict(enumerate(shift)))
    place.tool_offset = tool
    size = 4.0 * max(map(abs, point + origin + shift + tool)) + 1e-300
    assert place.to_program(place.to_machine(point)) == pytest.approx(
        point, rel=1e-12, abs=1e-15 * size
    )
    assert place.to_machine(place.to_program(point)) == pytest.approx(
        point, rel=1e-12, abs=1e-15 * size
    )


@given(
    POINTS,
    POINTS,
    st.dictionaries(st.integers(0, 2), NUMBERS, min_size=1),
    st.floats(-720, 720),
    st.sampled_from(["L20", "G92", "L10"]),
)
def test_the_position_gets_the_given_values(
    point: list[float], origin: list[float], values: dict[int, float], angle: float, way: str
) -> None:
    """G10 L20, G92 and G10 L10: the given axes have their values, the others do not change."""
    place = fresh()
    place.set_origin(0, dict(enumerate(origin)), rotation=angle)
    before = place.to_program(point)
    if way == "L20":
        place.set_origin_here(0, values, point)
    elif way == "G92":
        place.set_shift_here(values, point)
    else:
        tool = place.tool_for([0.0, 0.0, 0.0], values, point)
        place.tool_offset = [tool.get(index, 0.0) for index in range(3)]
    expected = [values.get(index, old) for index, old in enumerate(before)]
    assert place.to_program(point) == pytest.approx(expected, rel=1e-12, abs=1e-11)

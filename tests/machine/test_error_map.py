"""Error maps in a machine file: what is read, and what is refused at its line."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cnc.boards.registry import open_board
from cnc.machine.error_map import ErrorMap
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.diagnostics import MachineFileError, UsageError

LIMITS = "steps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\nmax_jerk = 9000\n"
HEADING = "x,y,z,dx,dy,dz\n"
PLACES = (0, 100, 200), (0, 100), (-50, 0)


def rows(errors=lambda *_: (0.01, 0.0, 0.0), places=PLACES) -> str:
    return "".join(",".join(map(str, (*at, *errors(*at)))) + "\n" for at in product(*places))


GOOD = HEADING + rows()


def load(tmp_path: Path, text: str | None, *, letters="xyz", x: str = "travel = [0, 200]", more=""):
    if text is not None:
        (tmp_path / "map.csv").write_text(text)
    travels = {"x": x, "y": "travel = [0, 100]", "z": "travel = [-50, 0]"}
    axes = "".join(f"[axes.{letter}]\n{LIMITS}{travels[letter]}\n" for letter in letters)
    file = tmp_path / "m.toml"
    file.write_text(f'[machine]\nerror_map = "map.csv"\n{axes}{more}')
    return load_machine(file)


def test_the_map_is_read_in_any_order(tmp_path: Path) -> None:
    def errors(x, y, z):
        return 0.0001 * x, 0.0002 * y, -0.0003 * z

    lines = rows(errors).splitlines(keepends=True)
    known = load(tmp_path, "# measured\n" + HEADING + "".join(lines[::-1]))
    assert isinstance(known, Machine)
    assert isinstance(known.error_map, ErrorMap)
    assert known.is_compensated
    places = np.array([[30.0, 40.0, -20.0], [200.0, 100.0, 0.0]])
    expected = [errors(*place) for place in places.tolist()]
    assert np.abs(known.error_map.volume.error(places) - expected).max() < 1e-15
    tips = places + expected
    assert np.abs(known.compensation.motors_at(tips) - places).max() < 1e-6


def test_a_map_of_one_height_is_for_all_heights(tmp_path: Path) -> None:
    known = load(tmp_path, HEADING + rows(places=(PLACES[0], PLACES[1], (0,))))
    assert known.compensation.motors_at(np.array([[50.0, 50.0, -40.0]]))[0].tolist() == (
        pytest.approx([49.99, 50.0, -40.0], abs=1e-9)
    )


def bump(x, *_):
    return (0.15 if x == 100 else 0.0, 0.0, 0.0)


WRONG = [
    (None, "map.csv is not readable: No such file"),
    ("", "the first line of map.csv must be x,y,z,dx,dy,dz"),
    (GOOD.replace("x,y,z", "x,z,y"), "the first line of map.csv must be x,y,z,dx,dy,dz"),
    (HEADING + "0,0,0,0,0,0\n", "map.csv has 1 points: a map has 2 to"),
    (GOOD + "1,2,3,4\n", "line 14 of map.csv must have 6 numbers"),
    (GOOD + "1,2,3,4,5,inf\n", "line 14 of map.csv must have 6 numbers"),
    (GOOD + "0,0,0,0,0,0\n", "lines 3 and 14 of map.csv are for one point"),
    (
        GOOD.replace("100,0,0,0.01,0.0,0.0\n", ""),
        "map.csv has no point X100 Y0 Z0: the points must be a grid, 3 x 2 x 2 here; "
        "the nearest one is in line 6",
    ),
    (
        HEADING + rows(places=((0, 0.5, 200), (0, 100), (-50, 0))),
        "places along x are closer than 1",
    ),
    (
        HEADING + rows(lambda x, *_: (-12.0 * (x == 200), 0.0, 0.0)),
        "lines 6 and 10 of map.csv: dx changes by 12 over 100 mm, which no machine does",
    ),
    (HEADING + rows(bump), "of map.csv: the map is too coarse there"),
    (
        HEADING + rows(places=((0, 100), (0, 100), (-50, 0))),
        "the map is for X0 to 100, the travel is 0 to 200",
    ),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_wrong_maps_are_errors_at_the_line_of_the_machine_file(
    tmp_path: Path, text: str | None, message: str
) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, text)
    assert message in caught.value.diagnostic.message
    assert caught.value.diagnostic.message.startswith("machine.error_map: ")
    assert caught.value.diagnostic.line == 2


def test_a_point_between_makes_a_coarse_map_fine(tmp_path: Path) -> None:
    """The same bump, measured every 12.5 mm."""

    def smooth(x, *_):
        return 0.15 * np.sin(np.pi * x / 200.0) ** 2, 0.0, 0.0

    places = tuple(12.5 * k for k in range(17))
    assert load(tmp_path, HEADING + rows(smooth, (places, *PLACES[1:]))).is_compensated


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"letters": "xy"}, "the machine has no axis z"),
        ({"x": ""}, "a map needs the travel of x that it is for"),
        (
            {"more": f'[axes.a]\n{LIMITS}\n[axes.c]\n{LIMITS}\n[kinematics]\ntype = "xyzac"\n'},
            "the compensation of errors needs a motor for each axis",
        ),
    ],
)
def test_a_map_that_does_not_fit_the_machine_is_an_error(tmp_path: Path, changes, message) -> None:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, GOOD, **changes)
    assert message in caught.value.diagnostic.message


def test_a_board_that_takes_lines_refuses_the_map(tmp_path: Path) -> None:
    known = load(tmp_path, GOOD)
    with pytest.raises(UsageError) as caught:
        open_board(known, kind="grbl-sim")
    assert caught.value.diagnostic.code == "compensation-on-board"

"""Section 4 of Shu et al. (2019): published values beside those of the page, and the shells that
walk them.
"""

import numpy as np
import pytest

from cnc.papers import half_step, page


@pytest.fixture(scope="module")
def section():
    return half_step.section()


def test_steps_and_radii_of_the_circle(section):
    rows = {row[0]: row for row in section.tables[0].rows}
    assert [row[2] for row in rows.values()] == [80, 80, 56]
    assert rows["half-step"][4] == "9.849 .. 10.440"
    assert rows["point-by-point, F > 0 goes inward"][4] == "9.055 .. 10.817"
    assert rows["point-by-point, F >= 0 goes inward"][4] == "9.000 .. 10.770"


def test_no_radius_is_worse(section):
    rows = {row[0]: row for row in section.tables[1].rows}
    assert max(float(cell) for cell in rows["half-step"][2:4]) == pytest.approx(0.49896, abs=1e-5)
    for name, row in rows.items():
        assert max(float(cell) for cell in row[2:4]) <= (0.5 if name == "half-step" else 1.0)
        assert row[4] == pytest.approx(
            (4 * np.sqrt(2) if name == "half-step" else 8) * half_step.LARGE, rel=1e-4
        )


def test_the_octants_are_those_of_figure_6(section):
    rows = [row[1:] for row in section.tables[2].rows]
    assert rows[0] == ["+Y, -X+Y", "+X-Y, -Y"]
    assert rows[1] == ["-X, -X+Y", "+X, +X-Y"]
    # each octant is the one before, a quarter or two back, turned
    assert rows[4] == ["+X-Y, -Y", "+Y, -X+Y"]
    assert len({tuple(row) for row in rows}) == 8


def test_the_line_by_both(section):
    point, half = section.tables[3].rows
    assert point[1] == 14 and half[1] == 10
    assert float(half[2]) <= 0.5 and float(point[2]) <= 1.0


@pytest.mark.soak
def test_the_figures_are_drawn(section, tmp_path):
    text = page.write([section], tmp_path).read_text()
    for figure in section.figures:
        assert f"({figure.name}.png)" in text
        assert (tmp_path / f"{figure.name}.png").stat().st_size > 10_000


def test_a_line_in_space():
    walked = half_step.half_step_line([7, -3, 5])
    assert walked.tolist()[0] == [0, 0, 0] and walked.tolist()[-1] == [7, -3, 5]
    assert len(walked) == 8
    np.testing.assert_array_less(np.abs(walked - np.outer(walked[:, 0], [1, -3 / 7, 5 / 7])), 0.5)


@pytest.mark.parametrize("wrong", [[0, 0], [0.5, 1], [2**28, 1], [[1, 2]]])
def test_ends_that_are_no_grid_points_are_refused(wrong):
    for line in (half_step.half_step_line, half_step.point_by_point_line):
        with pytest.raises(ValueError):
            line(wrong)
    with pytest.raises(ValueError):
        half_step.point_by_point_line([1, 2, 3])


@pytest.mark.parametrize("wrong", [0, -1, 2**28])
def test_radii_that_are_none_are_refused(wrong):
    for circle in (half_step.half_step_circle, half_step.point_by_point_circle):
        with pytest.raises(ValueError):
            circle(wrong)

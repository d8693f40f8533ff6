"""Section 5 of Hui, Wei and Gao (2013): published values beside those of the page."""

import numpy as np
import pytest

from cnc.papers import nurbs_lookahead as paper
from cnc.papers import page


@pytest.fixture(scope="module")
def section():
    return paper.section()


def column(table, title):
    return {row[0]: row[table.columns.index(title)] for row in table.rows}


def test_the_paper_s_algorithm_gives_the_paper_s_extremes(section):
    published, ours = (
        column(section.tables[0], title) for title in ("published", "the same, the trident")
    )
    assert float(ours["h, largest, mm"]) == pytest.approx(
        float(published["h, largest, mm"]), rel=2e-3
    )
    assert float(ours["h, smallest, mm"]) < 1e-11 and float(published["h, smallest, mm"]) < 1e-11
    assert float(ours["delta, largest"]) == pytest.approx(
        float(published["delta, largest"]), rel=0.03
    )
    assert float(ours["delta, smallest"]) < 1e-5
    assert float(ours["a, largest, mm/s^2"]) == pytest.approx(2400, rel=1e-6)
    assert -2400 <= float(ours["a, smallest, mm/s^2"]) < -2300
    # the first step of the S-curve, J T^2, which the paper has in m/s
    assert float(ours["F, smallest, m/min"]) == pytest.approx(
        60 * float(published["F, smallest, m/min"]), rel=1e-3
    )


def test_where_the_normal_acceleration_binds_the_chord_error_follows_from_it():
    run = paper.papers_run(paper.curve(paper.TRIDENT), look_ahead=True)
    assert run.chord_error.max() == pytest.approx(4903.325 * 0.001**2 / 8, rel=2e-3)


def test_the_feed_of_the_paper_is_reached_only_with_nothing_that_holds_the_acceleration():
    limits = paper.machine().path
    path = paper.curve(paper.TRIDENT)
    free = limits.model_copy(update={"max_tangential_acceleration": None, "max_jerk": None})
    assert paper.interpolate(path, free).feed.max() == pytest.approx(300.0)
    assert paper.interpolate(path, limits, look_ahead=False).feed.max() < 0.9 * 17.916 / 0.06


def test_the_plan_alone_keeps_the_jerk(section):
    jerk = {
        name: float(value)
        for name, value in column(section.tables[1], "largest jerk, mm/s^3").items()
    }
    assert jerk["our plan, sampled"] <= 48000
    assert jerk["paper, with look-ahead"] > 20 * 48000
    assert jerk["paper, adaptive step alone"] > jerk["paper, with look-ahead"]


def test_our_samples_keep_the_chord_error_and_the_deviation():
    run = paper.planned_run(paper.curve(paper.TRIDENT))
    assert run.chord_error.max() <= 4903.325 * 0.001**2 / 8 * (1 + 1e-4)
    assert run.deviation.max() <= 1e-3 * (1 + 1e-9)
    assert run.position[-1] == pytest.approx([10.0, 0.0, 0.0], abs=1e-12)
    assert np.abs(run.accel).max() <= 2400 * (1 + 1e-9)


@pytest.mark.soak
def test_every_figure_of_the_paper_is_drawn(section, tmp_path):
    assert [figure.title.split(".")[0] for figure in section.figures] == [
        f"Figure {k}" for k in range(4, 11)
    ]
    text = page.write([section], tmp_path).read_text()
    for figure in section.figures:
        assert f"({figure.name}.png)" in text
        assert (tmp_path / f"{figure.name}.png").stat().st_size > 10_000

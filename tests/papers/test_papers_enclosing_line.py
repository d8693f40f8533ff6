"""The experiments of the 2002 paper: figures of the page."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.papers import enclosing_line
from cnc.papers.page import Section, Table, write


@pytest.fixture(scope="module")
def section() -> Section:
    """Return the section; each of its times is measured once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(enclosing_line, "REPEATS", 1)
        return enclosing_line.section()


def numbers(table: Table, column: str, nth: int = 0) -> list[float]:
    """Return the numbers of a column."""
    place = [k for k, name in enumerate(table.columns) if name == column][nth]
    return [float(str(row[place])) for row in table.rows if row[place] != ""]


def test_operations(section: Section) -> None:
    assert [row[1:] for row in section.tables[0].rows] == [["36, 15, 12"] * 2, ["5, 2, 0"] * 2]


@pytest.mark.parametrize(("number", "rows", "error"), [(1, 5655, 0.4999), (2, 16185, 0.499999)])
def test_circle_and_polynomial(section: Section, number: int, rows: int, error: float) -> None:
    """The digits equal those of the paper's procedure, with ours beside them.

    The ratio of times is printed; benchmarks compare it with the paper's.
    """
    table = section.tables[number]
    assert numbers(table, "iterations, as printed") == [pytest.approx(rows, abs=1)] * 2
    assert numbers(table, "ours", 2) == [pytest.approx(rows, abs=2)] * 2
    assert numbers(table, "as printed")[1] == pytest.approx(
        error, abs=2e-6 if number == 2 else 1e-4
    )
    assert max(numbers(table, "as printed") + numbers(table, "ours")) <= 0.5
    assert float(str(table.rows[-1][5])) > 0.0


def test_further(section: Section) -> None:
    table = section.tables[3]
    ours = [row for row in table.rows if "printed" not in str(row[1])]
    assert len(ours) == 10
    assert all(
        row[4] == 0 and float(str(row[5])) <= 0.5 + 1e-6 and float(str(row[6])) <= 0.5
        for row in ours
    )
    assert any(
        row[4] == 1 and float(str(row[5])) == pytest.approx(0.534, abs=1e-3) for row in table.rows
    )


def test_the_page(section: Section, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    page = write([section], tmp_path).read_text(encoding="utf-8")
    for name in ("enclosing-line-circle.png", "enclosing-line-polynomial.png"):
        assert name in page and (tmp_path / name).stat().st_size > 10_000

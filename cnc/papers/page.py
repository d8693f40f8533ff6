"""A page of tables and figures, and its files.

    papers.md           the sections one after the other, tables as Markdown, figures as links
    NAME.png            one file a figure

matplotlib draws the figures. It comes with the extra ``view`` and is imported late. Without it the
page has the tables alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from cnc.model.diagnostics import Diagnostic, UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Cell: TypeAlias = str | int | float

PAGE = "papers.md"
DOTS_PER_INCH = 120


@dataclass(frozen=True, slots=True)
class Table:
    """Rows under columns.

    Numbers are written with six digits, integers in full. note: text below the table.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture NAME.png of ``size`` (width, height) in inches.

    ``draw`` takes the empty figure and adds its axes.
    """

    name: str
    title: str
    draw: Callable[[Canvas], None]
    size: tuple[float, float] = (7.0, 4.0)


@dataclass(frozen=True, slots=True)
class Section:
    """Results of the experiments of one paper."""

    title: str
    text: str
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()


def prepared(folder: Path) -> Path:
    """Make the folder if necessary, before any work is done.

    Raises:
        UsageError: ``can-not-write``.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _can_not_write(folder, error) from None
    return folder


def drawing_missing() -> Diagnostic | None:
    """Return a warning if the figures cannot be drawn."""
    try:
        with _canvas((1.0, 1.0)):
            pass
    except ImportError:
        message = "the figures need matplotlib, which is not installed; the tables are complete"
        hint = "pip install 'cncrun[view]', or pip install matplotlib"
        return Diagnostic("figures-missing", message, hint=hint, severity="warning")
    return None


def write(sections: Iterable[Section], folder: Path, *, draws: bool = True) -> Path:
    """Write page and pictures into an existing folder.

    Args:
        sections: The sections.
        folder: The folder.
        draws: Whether to draw the figures, and to name them on the page.

    Returns:
        The file of the page.

    Raises:
        UsageError: ``can-not-write``.
    """
    page = folder / PAGE
    try:
        parts = ["# The papers' experiments"]
        for section in sections:
            if not draws:
                section = replace(section, figures=())
            for figure in section.figures:
                _save(figure, folder / f"{figure.name}.png")
            parts.append(markdown(section))
        page.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    except OSError as error:
        raise _can_not_write(error.filename or page, error) from None
    return page


def markdown(section: Section) -> str:
    """Return the section as Markdown, with links to its figures."""
    parts = [f"## {section.title}", section.text]
    parts += [_table(table) for table in section.tables]
    parts += [
        f"![{figure.title}]({figure.name}.png)\n\n{figure.title}" for figure in section.figures
    ]
    return "\n\n".join(parts)


def _table(table: Table) -> str:
    rows = [[_cell(cell) for cell in row] for row in (table.columns, *table.rows)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        for row in rows
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    text = f"**{table.title}**\n\n" + "\n".join(lines)
    return f"{text}\n\n{table.note}" if table.note else text


def _cell(cell: Cell) -> str:
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell).replace("|", "\\|")


def _save(figure: Figure, file: Path) -> None:
    with _canvas(figure.size) as canvas:
        figure.draw(canvas)
        canvas.savefig(file)


@contextmanager
def _canvas(size: tuple[float, float]) -> Iterator[Canvas]:
    """Give an empty figure of a size in inches; ImportError without matplotlib."""
    import matplotlib.figure  # the tables do not need it

    with matplotlib.rc_context(
        {"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "lines.linewidth": 1.0}
    ):
        yield matplotlib.figure.Figure(figsize=size, dpi=DOTS_PER_INCH, layout="constrained")


def _can_not_write(place: Path | str, error: OSError) -> UsageError:
    hint = "name a folder that can be written: cncrun papers DIR"
    return UsageError(Diagnostic("can-not-write", f"{place}: {error.strerror or error}", hint=hint))

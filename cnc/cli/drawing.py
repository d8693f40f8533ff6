"""The progress bar and the table of a run, drawn on standard error by rich.

Most commands end before anything is drawn, so this is imported when the first drawing is due.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text


class Bar:
    """A progress bar. Other output appears above it, unless that goes to a file."""

    def __init__(self) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[counted]}"),
            TimeElapsedColumn(),
            TextColumn("{task.fields[note]}"),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=sys.stdout.isatty(),
        )
        self._progress.start()
        self._task = self._progress.add_task("", counted="", note="")

    def update(self, stage: str, done: int, total: int | None, counted: str, note: str) -> None:
        """Draw how much is done of ``total`` (None: not known yet), with two texts."""
        self._progress.update(
            self._task, description=stage, completed=done, total=total, counted=counted, note=note
        )

    def remove(self) -> None:
        """Remove the bar."""
        self._progress.stop()


class LiveTable:
    """A table of labels and texts. Other output appears above it.

    Args:
        console: The terminal; None for standard error.
    """

    def __init__(self, console: Console | None) -> None:
        self._live = Live(
            console=console or Console(stderr=True), auto_refresh=False, transient=True
        )
        self._live.start()

    def update(self, rows: Iterable[tuple[str, str]]) -> None:
        """Draw the rows."""
        table = Table.grid(padding=(0, 2))
        table.add_column(style="bold", no_wrap=True)
        table.add_column(overflow="fold")
        for label, text in rows:
            table.add_row(label, Text(text))
        self._live.update(table, refresh=True)

    def remove(self) -> None:
        """Remove the table."""
        self._live.stop()

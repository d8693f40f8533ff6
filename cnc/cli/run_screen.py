"""The screen while a program runs: state, positions, feed, spindle, tool, line, time, and keys."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING

from cnc.cli.keyboard import HELP
from cnc.model.diagnostics import printable
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    from rich.console import Console

    from cnc.cli.drawing import LiveTable
    from cnc.session.run_pulses import Progress

DELAY = 1.0
"""Seconds of a run until the screen appears: a short run needs none."""
INTERVAL = 0.3
"""Shortest time between two drawings, s."""
PLAIN_INTERVAL = 10.0
"""Seconds between two lines of the plain display."""


def clock(seconds: float) -> str:
    """Return minutes and seconds, with hours where there are any."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02d}:{second:02d}" if hours else f"{minute}:{second:02d}"


def position(axes: Iterable[str], values: Iterable[float]) -> str:
    """Return a position with the letters of its axes."""
    return "  ".join(
        f"{axis.upper()}{value:10.3f}" for axis, value in zip(axes, values, strict=False)
    )


def overrides(sent: Progress, control: Control) -> str:
    """Return the overrides of feed, traverses and spindle: as reported, else as requested."""
    reported = None if sent.machine is None else sent.machine.overrides
    feed, rapid, spindle = reported or (
        control.feed_override,
        control.rapid_override,
        control.spindle_override,
    )
    waits = f" (in {sent.pending:.1f} s at most)" if sent.pending > 0.0 else ""
    return f"feed {feed:g} %{waits}  traverses {rapid:g} %  spindle {spindle:g} %"


def rows(
    sent: Progress, control: Control, total: int | None, keys: str = HELP
) -> Iterator[tuple[str, str]]:
    """Yield the label and the text of each row that is known.

    Args:
        sent: The progress.
        control: The operator's requests.
        total: The last line of the program; None if it is not known.
        keys: Text about the keys.
    """
    axes, machine = sent.axes, sent.machine
    state = machine.state if machine is not None else "Hold" if sent.held else "Run"
    reason = f": {sent.hold_reason}" if sent.hold_reason else ""
    yield "state", f"{state}{reason}" if not sent.held else f"{state}, held{reason}"
    number = sent.at or sent.line
    place = f"{number} of {total}" if total else f"{number}"
    yield "line", f"{place}  {printable(sent.text)}".rstrip()
    if machine is not None and machine.work:
        yield "work", position(axes, machine.work)
    if sent.position is not None:
        yield "machine", position(axes, sent.position)
    planned = "traverse" if sent.feed is None else f"{sent.feed:.0f} mm/min"
    if machine is not None and machine.feed is not None:
        yield "feed", f"{planned}, actual {machine.feed:.0f} mm/min"
    words = []
    if machine is not None and machine.spindle is not None:
        words.append(f"{machine.spindle:.0f} rev/min")
    if sent.tool is not None:
        words.append(f"tool {sent.tool}")
    if words:
        yield "spindle", "  ".join(words)
    yield "overrides", overrides(sent, control)
    left = [] if sent.left is None else [f"{clock(sent.left)} left"]
    if sent.buffered is not None:
        left.append(f"{sent.buffered} lines in the buffer")
    if sent.ahead is not None:
        left.append(f"{sent.ahead:.2f} s in the buffer")
    if left:
        yield "time", "  ".join(left)
    yield "keys", keys


class RunScreen:
    """Shows the progress of a run on a terminal, on standard error.

    Args:
        control: The operator's requests.
        console: The terminal; None for standard error.
        keys: Text about the keys.
    """

    def __init__(self, control: Control, console: Console | None = None, keys: str = HELP) -> None:
        self._control, self._console, self._keys = control, console, keys
        self._table: LiveTable | None = None
        self._began = monotonic()
        self._drawn = 0.0

    @property
    def shown(self) -> bool:
        """Whether the screen has appeared."""
        return self._table is not None

    def update(self, sent: Progress, total: int | None) -> None:
        """Draw the progress, unless it was drawn just now.

        Args:
            sent: The progress.
            total: The last line of the program; None if it is not known.
        """
        now = monotonic()
        if now - self._began < DELAY or (self._table and now - self._drawn < INTERVAL):
            return
        self._drawn = now
        if self._table is None:
            from cnc.cli.drawing import LiveTable  # a short run needs none

            self._table = LiveTable(self._console)
        # A terminal that is gone is reported by a signal.
        with suppress(OSError):
            self._table.update(rows(sent, self._control, total, self._keys))

    def close(self) -> None:
        """Remove the screen."""
        if self._table is not None:
            with suppress(OSError):
                self._table.remove()


class PlainLines:
    """Prints a line on standard error every PLAIN_INTERVAL seconds, for logs."""

    def __init__(self, control: Control) -> None:
        self._control = control
        self._printed = monotonic()

    def update(self, sent: Progress, total: int | None) -> None:
        """Print the progress, unless a line was printed just now; see :meth:`RunScreen.update`."""
        now = monotonic()
        if now - self._printed < PLAIN_INTERVAL:
            return
        self._printed = now
        texts = dict(rows(sent, self._control, total))
        words = [texts["state"]]
        if sent.at or sent.line:  # Homing has no lines.
            words.append("line " + texts["line"].partition("  ")[0])
        words += [" ".join(texts[label].split()) for label in ("machine", "time") if label in texts]
        print("; ".join(words), file=sys.stderr, flush=True)

"""Progress of a program on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EIO
from time import monotonic
from typing import TYPE_CHECKING

import cnc
from cnc.cli.keyboard import HELP, NO_TERMINAL
from cnc.cli.run_screen import PlainLines, RunScreen
from cnc.cli.signals import OperatorSignals, report_hang_up
from cnc.model.diagnostics import Diagnostic, shown_name
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    from cnc.cli.drawing import Bar
    from cnc.session.context import Stage
    from cnc.session.run_pulses import Progress as Sent


class ProgressDisplay:
    """Shows the progress of a program, and serves signals (:mod:`cnc.cli.signals`).

    While lines or pulses are sent, a screen shows the machine (:mod:`cnc.cli.run_screen`). Where
    standard output is no terminal, or ``plain``, a line now and then takes its place.
    """

    def __init__(self, control: Control, *, quiet: bool, plain: bool = False) -> None:
        self._quiet, self._plain = quiet, plain
        self._screen: RunScreen | PlainLines | None = None
        self._total: int | None = None
        self._control = control
        self._bar: _ProgressBar | None = None
        self._held = False
        self._signals = OperatorSignals(control)
        self._keys = HELP

    def without_keys(self) -> None:
        """Name no keys: no terminal gives them."""
        self._keys = NO_TERMINAL

    def callbacks(self) -> cnc.Callbacks:
        """Return the callbacks that keep the display up to date."""
        return cnc.Callbacks(
            on_progress=self._on_progress,
            on_warning=None if self._quiet else self.warn,
            on_compiling=None if self._quiet or self._bar else print_compiling,
            on_kernel=None if self._bar is None else self._bar.compiling,
            on_sent=self._on_sent,
        )

    def count(self, done: int, total: int) -> None:
        """Show the number of programs that have been checked."""
        if self._bar is not None:
            self._bar.update("checking", done, total, "programs")

    def warn(self, diagnostic: Diagnostic) -> None:
        """Print a warning or note."""
        if not self._quiet:
            print(f"{diagnostic.severity}: {diagnostic.render()}", file=sys.stderr)

    def __enter__(self) -> ProgressDisplay:
        self._signals.__enter__()
        if not self._quiet and sys.stderr.isatty():
            self._bar = _ProgressBar()
        return self

    def __exit__(self, *_: object) -> None:
        if isinstance(self._screen, RunScreen):
            self._screen.close()
        if self._bar is not None:
            self._bar.close()
        self._signals.__exit__()

    def _on_progress(self, stage: Stage, done: int, total: int | None) -> None:
        self._signals.moving = stage == "running"
        self._total = total
        if self._bar is not None and self._screen is None:
            with _terminal_may_go():
                self._bar.update(stage, done, total)

    def _on_sent(self, sent: Sent) -> None:
        with _terminal_may_go():
            self._print(sent)
        if sent.at_rest:
            self._signals.at_rest()

    def _print(self, sent: Sent) -> None:
        if not self._quiet:
            self._show(sent)
        if sent.held and not self._held and not self._quiet:
            place = f"{shown_name(sent.hold_reason)}, line" if sent.hold_reason else "held at line"
            print(f"{place} {sent.line}; {self._keys}", file=sys.stderr, flush=True)
        self._held = sent.held

    def _show(self, sent: Sent) -> None:
        """Show the progress of the board."""
        if self._screen is None:
            live = self._bar is not None and not self._plain and sys.stdout.isatty()
            if self._bar is not None:
                self._bar.close()
            self._screen = (
                RunScreen(self._control, keys=self._keys) if live else PlainLines(self._control)
            )
        self._screen.update(sent, self._total)


@contextmanager
def _terminal_may_go() -> Iterator[None]:
    """Report a hang-up where an output fails because the terminal is gone."""
    try:
        yield
    except OSError as error:
        if error.errno != EIO:
            raise
        report_hang_up()


def print_compiling() -> None:
    """Print why the first run takes longer."""
    print(
        "compiling the kernels that this program needs; this happens once",
        file=sys.stderr,
        flush=True,
    )


class _ProgressBar:
    """A progress bar on standard error. It appears after a delay, s."""

    DELAY = 1.0

    def __init__(self) -> None:
        self._began = monotonic()
        self._drawing: Bar | None = None
        self._drawn = 0.0
        self.note = ""

    def update(self, stage: str, done: int, total: int | None, unit: str = "lines") -> None:
        """Show how much is done of ``total`` (None: not known yet)."""
        now = monotonic()
        if now - self._began < self.DELAY or now - self._drawn < 0.1:
            return
        self._drawn = now
        counted = f"{done} {unit}" if unit == "lines" else f"{done} of {total} {unit}"
        if self._drawing is None:
            from cnc.cli.drawing import Bar  # most commands are over before the delay

            self._drawing = Bar()
        self._drawing.update(stage, done, total, counted, self.note)

    def compiling(self, done: int, total: int, kernel: str) -> None:
        """Show how many kernels are compiled, and which one is next."""
        self._began = 0.0  # without delay, because this takes long
        self.note = kernel
        self.update("compiling, once on this computer", done, total, "kernels")
        self.note = ""

    def close(self) -> None:
        """Remove the bar."""
        if self._drawing is not None:
            self._drawing.remove()
            self._drawing = None

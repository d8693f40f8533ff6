"""What a terminal shows while a program is under way, and what Ctrl-C does."""

from __future__ import annotations

import signal
import sys
import threading
from time import monotonic
from typing import TYPE_CHECKING, Any

from cnc.cli.keyboard import HELP
from cnc.model.diagnostics import Diagnostic
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    from rich.progress import Progress

    from cnc.api import Watch
    from cnc.executor.run import Progress as Sent
    from cnc.session import Stage


class Screen:
    """What is shown while a program is under way, and the operator's Ctrl-C (or a termination from
    outside).

    As long as nothing moves it ends the program. In motion the first asks for a stop, the second
    ends at once.
    """

    def __init__(self, control: Control, *, quiet: bool) -> None:
        self._quiet = quiet
        self._control = control
        self._bar: _Bar | None = None
        self._moving = self._held = False
        self._before: dict[signal.Signals, Any] = {}

    def watch(self) -> Watch:
        """For the library to call back."""
        from cnc.api import Watch

        return Watch(
            on_progress=self._on_progress,
            on_warning=None if self._quiet else self.warn,
            on_compiling=None if self._quiet else tell_compiling,
            on_sent=self._on_sent,
        )

    def count(self, done: int, total: int) -> None:
        """Programs that have been checked."""
        if self._bar is not None:
            self._bar.update("checking", done, total, "programs")

    def warn(self, diagnostic: Diagnostic) -> None:
        """Show a finding that ends nothing."""
        if not self._quiet:
            print(f"{diagnostic.severity}: {diagnostic.render()}", file=sys.stderr)

    def __enter__(self) -> Screen:
        if threading.current_thread() is threading.main_thread():
            self._before = {
                each: signal.signal(each, self._on_signal)
                for each in (signal.SIGINT, signal.SIGTERM)
            }
        if not self._quiet and sys.stderr.isatty():
            self._bar = _Bar()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()
        for each, handler in self._before.items():
            signal.signal(each, handler)

    def _on_progress(self, stage: Stage, done: int, total: int | None) -> None:
        self._moving = stage == "running"
        if self._bar is not None:
            self._bar.update(stage, done, total)

    def _on_sent(self, sent: Sent) -> None:
        if self._bar is not None:
            self._bar.note = self._words(sent)
        if sent.held and not self._held and not self._quiet:
            print(
                f"held at line {sent.line}{f' ({sent.hold_reason})' if sent.hold_reason else ''}; {HELP}",
                file=sys.stderr,
                flush=True,
            )
        self._held = sent.held

    def _words(self, sent: Sent) -> str:
        """Where the board is and what it still has, as far as it tells; the operator's doing."""
        words = (
            [] if sent.position is None else [" ".join(f"{value:.3f}" for value in sent.position)]
        )
        if sent.left is not None:
            minutes, seconds = divmod(round(sent.left), 60)
            words.append(f"{minutes}:{seconds:02d} left")
        if sent.ahead is not None:
            words.append(f"{sent.ahead:.2f} s ahead")
        if sent.buffered is not None:
            words.append(f"{sent.buffered} lines waiting")
        if self._control.feed_override != 100.0:
            words.append(f"{self._control.feed_override:g} %")
        return "  ".join([*words, *(["held"] if sent.held else [])])

    def _on_signal(self, *_: object) -> None:
        if not self._moving:
            raise KeyboardInterrupt("stopped by the operator; nothing has moved")
        if self._control.stopped:
            raise KeyboardInterrupt(
                "stopped by the operator at once; where the axes stand has to be found again (home them)"
            )
        self._control.stop()


def tell_compiling() -> None:
    """Say why the first run ever takes longer."""
    print(
        "compiling the kernels; this happens once and takes up to a minute",
        file=sys.stderr,
        flush=True,
    )


class _Bar:
    """A progress bar on standard error, for what takes longer than a moment."""

    PATIENCE = 1.0

    def __init__(self) -> None:
        self._began = monotonic()
        self._progress: Progress | None = None
        self._drawn = 0.0
        self.note = ""

    def update(self, stage: Stage, done: int, total: int | None, unit: str = "lines") -> None:
        """How much is done of ``total`` (None: not known yet)."""
        now = monotonic()
        if now - self._began < self.PATIENCE or now - self._drawn < 0.1:
            return
        self._drawn = now
        if self._progress is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            counted = (
                f"{{task.completed:.0f}} {unit}"
                if unit == "lines"
                else f"{{task.completed:.0f}} of {total} {unit}"
            )
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn(counted),
                TimeElapsedColumn(),
                TextColumn("{task.fields[note]}"),
            )
            # What is printed meanwhile goes above the bar, unless it goes to a file.
            bar = Progress(
                *columns,
                console=Console(stderr=True),
                transient=True,
                redirect_stdout=sys.stdout.isatty(),
            )
            bar.start()
            self._progress = bar
            self._task = bar.add_task(stage, total=total, note=self.note)
        self._progress.update(
            self._task, description=stage, completed=done, total=total, note=self.note
        )

    def close(self) -> None:
        """Take the bar off the screen."""
        if self._progress is not None:
            self._progress.stop()

"""Checkpoint file of a run: the line that the run has reached, kept on disk beside the program.

After a fault the next run can continue there (``--from-line``).

    PROGRAM.checkpoint, JSON: `program`, `sha256` of its text, `line`, `position` {axis: mm},
    `machine`, `board`; `ended`: "" during the run (and after a crash of the computer), else the
    code of the fault, "stopped" by the operator, or "broken off"

The motion has reached the line, so all lines before it are done. No more is stored: units, plane,
offsets, feed, tool, spindle and coolant are found by reading the program again
(:mod:`cnc.session.resume`). The hash shows whether its text has changed. A thread writes the file,
because a slow disk must not delay the moves. A complete new file replaces the old one.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from cnc.executor.run import Progress

SUFFIX = ".checkpoint"
WRITE_INTERVAL = 0.5
"""Shortest time between two writes, s."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Content of the file. ``position`` is in machine coordinates, mm (degrees)."""

    program: str
    sha256: str
    machine: str
    board: str
    line: int = 0
    position: Mapping[str, float] | None = None
    ended: str = ""

    @classmethod
    def read(cls, program: str) -> Checkpoint | None:
        """Return the checkpoint of an unfinished run; None if there is none that can be read."""
        try:
            found = json.loads(Path(program + SUFFIX).read_text(encoding="utf-8"))
            known = cls(**found)
        except (OSError, ValueError, TypeError):
            return None
        return known if isinstance(known.line, int) and isinstance(known.sha256, str) else None


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class CheckpointWriter:
    """Keeps the checkpoint of one run up to date.

    Args:
        first: The checkpoint at the beginning of the run.
        axes: Letters of the axes, in the order of ``Progress.position``.
    """

    def __init__(self, first: Checkpoint, axes: tuple[str, ...]) -> None:
        self.latest = first
        self._axes = axes
        self._in_main_file = True
        self._file = Path(first.program + SUFFIX)
        self._written = first
        self._closed = threading.Event()
        self._thread = threading.Thread(
            target=self._write_regularly, daemon=True, name="checkpoint"
        )
        self._thread.start()

    def note(self, progress: Progress) -> None:
        """Note the progress of the run. A run cannot begin at a line of another file."""
        position = (
            self.latest.position
            if progress.position is None
            else dict(zip(self._axes, progress.position, strict=False))
        )
        self._in_main_file = progress.file in ("", self.latest.program)
        line = progress.at if progress.at > 0 and self._in_main_file else self.latest.line
        self.latest = replace(self.latest, line=line, position=position)

    def end(
        self,
        ended: str,
        line: int | None,
        position: Mapping[str, float],
        main_program_line: Callable[[int], int],
    ) -> int:
        """Close the checkpoint of a run that did not reach its end.

        Args:
            ended: The reason, as in the file.
            line: The line that the run has reached, if it is known exactly.
            position: The final position; empty to keep the last one.
            main_program_line: Returns the line of the main program for a line of a subprogram.

        Returns:
            The line to continue at, 0 if the run reached none.
        """
        self._close()
        line = line if line and self._in_main_file else self.latest.line
        line = main_program_line(line) if line else 0
        self.latest = replace(
            self.latest, ended=ended, line=line, position=dict(position) or self.latest.position
        )
        if self.latest.line:
            self._write(lasting=True)
        return self.latest.line

    def done(self) -> None:
        """Remove the file after a run that reached its end."""
        self._close()
        with contextlib.suppress(OSError):
            self._file.unlink(missing_ok=True)

    def _close(self) -> None:
        self._closed.set()
        self._thread.join()

    def _write_regularly(self) -> None:
        while not self._closed.wait(WRITE_INTERVAL):
            if self.latest != self._written and self.latest.line:
                self._write()

    def _write(self, *, lasting: bool = False) -> None:
        latest = self.latest
        if replace_json(self._file, asdict(latest), lasting=lasting):
            self._written = latest


def replace_json(target: Path, content: Mapping[str, object], *, lasting: bool) -> bool:
    """Replace a JSON file in one step. A failure does not stop the machine.

    Args:
        target: The file.
        content: Its new content.
        lasting: Wait until the data are on the disk.

    Returns:
        Whether the file was written.
    """
    draft = target.with_name(f".{target.name}.{os.getpid()}")
    with contextlib.suppress(OSError):
        with draft.open("w", encoding="utf-8") as file:
            json.dump(content, file)
            if lasting:
                file.flush()
                os.fsync(file.fileno())
        draft.replace(target)
        return True
    return False

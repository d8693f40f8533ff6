"""How far a run has come, kept on disk beside the program while it runs: after a fault the next one
goes on there (``--from-line``).

    PROGRAM.checkpoint, JSON: `program`, `sha256` of its text, `line`, `position` {axis: mm},
    `machine`, `board`; `ended`: "" while the run is under way (or its computer has died), else the
    code of the fault, "stopped" by the operator, or "broken off"

The line is one that the motion has come to: what lies before it has been done. It is enough: units,
plane, offsets, feed, tool, spindle and coolant there are found by reading the program again, whose
text is known by its hash (:mod:`cnc.session.resume`). Writing is left to a thread, for a slow disk
must not keep moves from the board; a draft that replaces the file is never seen half written.
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
EVERY_S = 0.5
"""So often, at most."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What is written; see above."""

    program: str
    sha256: str
    machine: str
    board: str
    line: int = 0
    position: Mapping[str, float] | None = None
    ended: str = ""

    @classmethod
    def read(cls, program: str) -> Checkpoint | None:
        """That of the last run of a program that did not come to its end; None if there is none, or
        none that can be understood.
        """
        try:
            found = json.loads(Path(program + SUFFIX).read_text(encoding="utf-8"))
            known = cls(**found)
        except (OSError, ValueError, TypeError):
            return None
        return known if isinstance(known.line, int) and isinstance(known.sha256, str) else None


def digest(text: Path) -> str:
    """The hash of a program's text."""
    with text.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Recorder:
    """Keeps the checkpoint of one run. ``first``: what is known of it from the beginning; axes:
    names of the position's numbers.
    """

    def __init__(self, first: Checkpoint, axes: tuple[str, ...]) -> None:
        self.latest = first
        self._axes = axes
        self._inside = True
        self._file = Path(first.program + SUFFIX)
        self._written = first
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._keep, daemon=True, name="checkpoint")
        self._thread.start()

    def note(self, progress: Progress) -> None:
        """How far the run is. A line of another file than the program's is not one to begin at."""
        position = (
            self.latest.position
            if progress.position is None
            else dict(zip(self._axes, progress.position, strict=False))
        )
        self._inside = progress.file in ("", self.latest.program)
        line = progress.at if progress.at > 0 and self._inside else self.latest.line
        self.latest = replace(self.latest, line=line, position=position)

    def end(
        self,
        ended: str,
        line: int | None,
        position: Mapping[str, float],
        place_to_begin: Callable[[int], int],
    ) -> int:
        """The run did not come to its end: the line to go on at, 0 if it never came to one.

        line: that it has come to, where that is known better. place_to_begin: the line of the main
        program that stands for one.
        """
        self._close()
        line = line if line and self._inside else self.latest.line
        line = place_to_begin(line) if line else 0
        self.latest = replace(
            self.latest, ended=ended, line=line, position=dict(position) or self.latest.position
        )
        if self.latest.line:
            self._write(lasting=True)
        return self.latest.line

    def done(self) -> None:
        """The run came to its end: there is nothing to go on with."""
        self._close()
        with contextlib.suppress(OSError):
            self._file.unlink(missing_ok=True)

    def _close(self) -> None:
        self._over.set()
        self._thread.join()

    def _keep(self) -> None:
        while not self._over.wait(EVERY_S):
            if self.latest != self._written and self.latest.line:
                self._write()

    def _write(self, *, lasting: bool = False) -> None:
        latest = self.latest
        if write_whole(self._file, asdict(latest), lasting=lasting):
            self._written = latest


def write_whole(target: Path, found: Mapping[str, object], *, lasting: bool) -> bool:
    """Replace a JSON file at once, so that nobody reads half of it; whether that went well.

    What can't be written is no reason to stop a machine. lasting: return when it is on the disk.
    """
    draft = target.with_name(f".{target.name}.{os.getpid()}")
    with contextlib.suppress(OSError):
        with draft.open("w", encoding="utf-8") as file:
            json.dump(found, file)
            if lasting:
                file.flush()
                os.fsync(file.fileno())
        draft.replace(target)
        return True
    return False

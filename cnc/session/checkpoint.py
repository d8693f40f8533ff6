"""Checkpoint file of a run: the line that the run has reached, kept on disk beside the program.

After a fault the next run can continue there (``--from-line``).

The file is ``PROGRAM.checkpoint``, JSON with the fields of :class:`Checkpoint`. The motion has
reached the line, so all lines before it are done. No more is stored: units, plane, offsets, feed,
tool, spindle and coolant are found by reading the program again (:mod:`cnc.session.resume`). The
hash shows whether its text has changed. A thread writes the file, because a slow disk must not
delay the moves. A complete new file replaces the old one.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from cnc.model.diagnostics import Diagnostic
from cnc.model.state_file import read_state
from cnc.session.run_pulses import Progress

SUFFIX = ".checkpoint"
WRITE_INTERVAL = 0.5
"""Shortest time between two writes, s."""


class Checkpoint(BaseModel):
    """Checkpoint of a run that has not reached the program's end."""

    # Most runs need no checkpoint: its validator is built when the first is made or read.
    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    program: str = Field(description="File name of the program.")
    sha256: str = Field(description="SHA-256 of the program's text, hexadecimal.")
    machine: str = Field(description="Name of the machine.")
    board: str = Field(description="Kind of the board.")
    line: int = Field(
        default=0,
        ge=0,
        le=1 << 53,
        description="Line that the motion has reached, from 1; 0: none.",
    )
    position: dict[str, FiniteFloat] | None = Field(
        default=None,
        description="Machine coordinates at that line, by axis; mm, degrees; null: unknown.",
    )
    ended: str = Field(
        default="",
        description='Empty during the run and after a crash of the computer; else "stopped" by '
        'the operator, "broken off", or the code of the error.',
    )

    @classmethod
    def read(cls, program: str) -> tuple[Checkpoint | None, list[Diagnostic]]:
        """Return the checkpoint of an unfinished run, None if there is none, and warnings."""
        hint = "the line that the last run has reached is not known; see where the tool stands"
        return read_state(Path(program + SUFFIX), cls, hint)


def checkpoint_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a checkpoint file."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Checkpoint.model_json_schema(),
    }


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
        self.latest = self.latest.model_copy(update={"line": line, "position": position})

    def end(
        self,
        ended: str,
        line: int | None,
        position: Mapping[str, float],
        line_to_continue_at: Callable[[int], int],
    ) -> int:
        """Close the checkpoint of a run that did not reach its end.

        Args:
            ended: The reason, as in the file.
            line: The line that the run has reached, if it is known exactly.
            position: The final position; empty to keep the last one.
            line_to_continue_at: Returns the line of the main program at which a run that reached a
                line can continue.

        Returns:
            The line to continue at, 0 if the run reached none.
        """
        self._close()
        line = line if line and self._in_main_file else self.latest.line
        line = line_to_continue_at(line) if line else 0
        final = dict(position) or self.latest.position
        self.latest = self.latest.model_copy(
            update={"ended": ended, "line": line, "position": final}
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
        if replace_json(self._file, latest.model_dump(), lasting=lasting):
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

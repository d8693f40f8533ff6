"""The library: a folder of programs, with the history and the log of their runs.

    LIBRARY/part.nc                        the programs
    LIBRARY/height-maps/plate.json         the height maps
    LIBRARY/.cncrun/history.jsonl          one run a line
    LIBRARY/.cncrun/logs/1764.250 part.nc  the log of the run that began at this time
    LIBRARY/.cncrun/part.nc.check.json     the summary of the last check
    LIBRARY/.cncrun/part.nc.path.json      its toolpath

A name is any plain file name with the ending of a program. No path leaves the folder: a link to
another place is no job. A file that is no job is left out, with the reason.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import tempfile
import unicodedata
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from cnc.machine.height_map import HeightMap, load_height_map
from cnc.model.diagnostics import Diagnostic, UsageError, printable
from cnc.operate.events import Finding
from cnc.operate.program_session import macro_names
from cnc.report.models import Summary
from cnc.session.checkpoint import Checkpoint

SUFFIXES = (".nc", ".ngc", ".gcode", ".tap", ".cnc", ".txt", ".h", ".mpf", ".spf", ".eia")
MOST_BYTES = 220
"""Longest name, so that those of the files about the job are possible as well."""
DEVICE = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?", re.IGNORECASE)
"""Names of devices on Windows."""
MAP_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,79}", re.ASCII)
MACRO_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _-]{0,79}\.(?:ngc|nc)", re.ASCII)
MAPS = "height-maps"
OWN = ".cncrun"
LOGS = "logs"
MOST_HISTORY = 1000
"""Runs of the history that are kept."""
MOST_LOGS = 200
"""Logs of runs that are kept."""
MOST_LOG = 2_000_000
"""Characters of a log that are sent."""
PIECE = 1 << 20
RESULTS = ("check.json", "path.json", "sketch.json", "part.json", "stl")
"""Files about a job that a change of its text makes wrong."""


Version = tuple[int, int, int]


def version_of(file: Path) -> Version:
    """Return what is another one when the text of a job is: inode, time of the change, size."""
    found = file.stat()
    return found.st_ino, found.st_mtime_ns, found.st_size


class Run(BaseModel):
    """A line of the history. The file has one at the beginning of a run and one at its end.

    Attributes:
        job: Name of the job.
        began: Time of its beginning, s since the epoch.
        seconds: Time that it took, s.
        machine_seconds: Machine time, s.
        outcome: ``running``, or how it ended; ``cut-off`` if the server was killed during it.
        line: Line at which it was stopped.
        resume_line: Line at which it can continue.
        findings: Its errors.
    """

    model_config = ConfigDict(frozen=True, strict=True)

    job: str
    began: FiniteFloat
    seconds: FiniteFloat = 0.0
    machine_seconds: FiniteFloat = 0.0
    outcome: Literal["running", "cut-off", "done", "stopped", "failed"] = "running"
    line: int | None = Field(default=None, ge=0, le=1 << 53)
    resume_line: int | None = Field(default=None, ge=0, le=1 << 53)
    findings: list[Finding] = []


class Library:
    """The jobs of a folder, which is made where it does not exist.

    Attributes:
        running: The run that this process has begun; None if it has none.

    Raises:
        UsageError: ``can-not-write``.
    """

    def __init__(self, folder: Path) -> None:
        try:
            (folder / OWN).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"the library {folder} cannot be made: {error.strerror}"
            raise UsageError(Diagnostic("can-not-write", message, hint="name another")) from error
        self.running: Run | None = None
        self.folder = folder.resolve()
        self.macros = self.folder / "macros"

    def names(self) -> list[str]:
        """Return the names of the jobs, sorted."""
        return sorted(name for name, why in self._files() if not why)

    def left_out(self) -> list[dict[str, str]]:
        """Return the files of the folder that are no jobs: ``name``, and ``why`` each is not."""
        return [
            {"name": printable(name), "why": why}
            for name, why in sorted(self._files())
            if why and not name.startswith(".") and not name.endswith(".checkpoint")
        ]

    def _files(self) -> Iterator[tuple[str, str]]:
        """Yield the name of each file, and why it is no job; empty for a job."""
        for entry in os.scandir(self.folder):
            if entry.is_symlink():
                yield entry.name, "it is a link"
            elif entry.is_file():
                yield entry.name, fault_of_name(entry.name)

    def path(self, name: str) -> Path:
        """Return the file of a job.

        Raises:
            UsageError: ``job-name`` for a name that is not allowed, ``no-such-job``.
        """
        file = self.folder / checked(name)
        if file.is_symlink() or not file.is_file():
            hint = "GET /api/jobs lists the jobs"
            raise UsageError(Diagnostic("no-such-job", f"there is no job {name}", hint=hint))
        return file

    def adopt(self, name: str, draft: Path) -> Path:
        """Make a file the text of a job; the old check of the job is removed.

        Raises:
            UsageError: ``job-name``, ``can-not-write``.
        """
        file = self.folder / checked(name)
        if file.is_symlink() or file.is_dir():
            message, hint = f"{name} is no file of the library", "choose another name"
            raise UsageError(Diagnostic("job-name", message, hint=hint))
        try:
            os.replace(draft, file)
        except OSError as error:
            message = f"{name} cannot be written: {error.strerror}"
            raise UsageError(Diagnostic("can-not-write", message, hint="is it in use?")) from error
        # Behind the change: a check that ends now sees it, or has written what is removed here.
        self.forget_check(name)
        return file

    def remove(self, name: str) -> None:
        """Remove a job and its files, but not its history."""
        self.path(name).unlink()
        for kind in RESULTS:
            self.own(name, kind).unlink(missing_ok=True)
        for _, log in self._logs(name):
            log.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            (self.folder / f"{name}.checkpoint").unlink()

    def forget_check(self, name: str) -> None:
        """Remove the result of the last check."""
        for kind in RESULTS:
            self.own(name, kind).unlink(missing_ok=True)

    def own(self, name: str, kind: str) -> Path:
        """Return a file about a job: one of RESULTS."""
        return self.folder / OWN / f"{checked(name)}.{kind}"

    def summary(self, name: str) -> dict[str, Any] | None:
        """Return the summary of the last check, None before the first or after a change."""
        job, file = self.path(name), self.own(name, "check.json")
        try:
            if file.stat().st_mtime_ns < job.stat().st_mtime_ns:
                return None
            return Summary.model_validate_json(file.read_bytes()).as_json()
        except (OSError, ValueError):  # the remedy is the same as before the first check
            return None

    def height_maps(self) -> list[str]:
        """Return the names of the height maps, sorted."""
        folder = self.folder / MAPS
        if not folder.is_dir():
            return []
        return sorted(
            entry.name.removesuffix(".json")
            for entry in os.scandir(folder)
            if entry.name.endswith(".json")
            and MAP_NAME.fullmatch(entry.name.removesuffix(".json"))
            and entry.is_file(follow_symlinks=False)
        )

    def height_map_file(self, name: str) -> Path:
        """Return the file of a height map. UsageError ``height-map-name``."""
        file = self.new_height_map(name)
        if file.is_symlink() or not file.is_file():
            hint = "GET /api/height-maps lists them"
            message = f"there is no height map {name}"
            raise UsageError(Diagnostic("height-map-name", message, hint=hint))
        return file

    def height_map(self, name: str) -> HeightMap:
        """Return a height map. UsageError ``height-map-name``, ``height-map-file``."""
        return load_height_map(self.height_map_file(name))

    def new_height_map(self, name: str) -> Path:
        """Return the file of a new height map. UsageError ``height-map-name``."""
        if not MAP_NAME.fullmatch(name) or DEVICE.fullmatch(name):
            message = f"{name[:80]!r} cannot be the name of a height map"
            hint = "use letters, digits, _ and -"
            raise UsageError(Diagnostic("height-map-name", message, hint=hint))
        folder = self.folder / MAPS
        folder.mkdir(exist_ok=True)
        return folder / f"{name}.json"

    def macro(self, name: str) -> Path:
        """Return the file of a macro. UsageError ``no-such-macro``."""
        if name not in macro_names(self.macros):
            hint = "GET /api/macros lists them"
            raise UsageError(Diagnostic("no-such-macro", f"there is no macro {name}", hint=hint))
        return self.macros / name

    def write_macro(self, name: str, text: str) -> None:
        """Write a macro as a whole. UsageError ``macro-unfit``, ``can-not-write``."""
        file = self.macros / name
        if not MACRO_NAME.fullmatch(name) or DEVICE.fullmatch(name) or file.is_symlink():
            hint = "use letters, digits, blanks, _ and -, and the ending .ngc"
            raise unfit_macro(f"{name[:80]!r} cannot be the name of a macro", hint)
        self.macros.mkdir(exist_ok=True)
        self._replace(file, text.encode("utf-8", "replace"))

    def add_run(self, run: Run, log: str) -> None:
        """Add the beginning or the end of a run to the history, and write its log."""
        self.running = run if run.outcome == "running" else None
        file = self.folder / OWN / "history.jsonl"
        with file.open("a+b") as target:
            if target.tell():
                target.seek(-1, os.SEEK_END)
                if target.read() != b"\n":  # the computer lost power
                    target.write(b"\n")
            target.write(run.model_dump_json().encode() + b"\n")
        if file.stat().st_size > MOST_HISTORY * 4000:
            kept = self.history(MOST_HISTORY // 2)
            lines = "".join(json.dumps(entry) + "\n" for entry in reversed(kept))
            self._replace(file, lines.encode())
        file = self._logs_folder() / f"{run.began:.3f} {run.job}"
        self._replace(file, log.encode("utf-8", "replace"))
        for _, old in self._logs()[MOST_LOGS:]:
            old.unlink(missing_ok=True)

    def history(self, most: int = MOST_HISTORY, job: str | None = None) -> list[dict[str, Any]]:
        """Return the runs, the latest first; of one job, or of all.

        Damaged lines are left out.
        """
        try:
            with (self.folder / OWN / "history.jsonl").open("rb") as file:
                lines = deque(file, maxlen=2 * MOST_HISTORY)
        except OSError:
            return []
        newest: dict[tuple[str, float], Run] = {}
        for line in lines:
            with contextlib.suppress(ValueError):
                run = Run.model_validate_json(line)
                if job is None or run.job == job:
                    newest[run.job, run.began] = run
        running = self.running
        return [
            run.model_copy(update={"outcome": "cut-off"}).model_dump()
            if run.outcome == "running" and run != running
            else run.model_dump()
            for run in list(reversed(newest.values()))[:most]
        ]

    def unfinished(self) -> dict[str, Any] | None:
        """Return the latest run if the server was killed during it, with the line it reached."""
        runs = self.history(1)
        if not runs or runs[0]["outcome"] != "cut-off" or runs[0]["job"] not in self.names():
            return None
        last, _ = Checkpoint.read(str(self.folder / runs[0]["job"]))
        line = 0 if last is None else last.line
        return {"job": runs[0]["job"], "began": runs[0]["began"], "line": line}

    def log(self, name: str, began: float | None = None) -> str:
        """Return the log of a run of a job, the end of a long one.

        Args:
            name: The job.
            began: Time of its beginning, s since the epoch; None for the last run.

        Returns:
            The log; empty if there is none, or none any more.
        """
        self.path(name)
        logs = self._logs(name)
        if began is not None:
            logs = [log for log in logs if math.isclose(log[0], began, rel_tol=0.0, abs_tol=1e-3)]
        try:
            return logs[0][1].read_text(encoding="utf-8")[-MOST_LOG:] if logs else ""
        except OSError:
            return ""

    def _logs_folder(self) -> Path:
        folder = self.folder / OWN / LOGS
        folder.mkdir(exist_ok=True)
        return folder

    def _logs(self, job: str | None = None) -> list[tuple[float, Path]]:
        """Return the logs of a job or of all, with the times of the runs, the latest first."""
        logs = []
        for entry in os.scandir(self._logs_folder()):
            began, _, name = entry.name.partition(" ")
            with contextlib.suppress(ValueError):
                if job in (None, name):
                    logs.append((float(began), Path(entry.path)))
        return sorted(logs, reverse=True)

    def _replace(self, file: Path, data: bytes) -> None:
        try:
            handle, draft = tempfile.mkstemp(dir=self.folder / OWN)
            with open(handle, "wb") as target:
                target.write(data)
            os.replace(draft, file)
        except OSError as error:
            message = f"{file.name} cannot be written: {error.strerror}"
            hint = "is the disk full, or the folder read-only?"
            raise UsageError(Diagnostic("can-not-write", message, hint=hint)) from error


def fault_of_name(name: str) -> str:
    """Return why a name cannot be that of a job; empty if it can."""
    if any(letter in "/\\:" or unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        return "it has a /, a \\, a : or a character that is no text"
    if name.startswith(".") or DEVICE.fullmatch(name):
        return "it begins with a dot, or is the name of a device"
    if Path(name).suffix.lower() not in SUFFIXES:
        return f"it ends in none of {', '.join(SUFFIXES)}"
    if len(name.encode()) > MOST_BYTES:
        return f"it is longer than {MOST_BYTES} bytes"
    return ""


def checked(name: str) -> str:
    """Return the name of a job; UsageError ``job-name`` if it is not allowed."""
    if why := fault_of_name(name):
        message = f"{name[:80]!r} cannot be the name of a job: {why}"
        hint = "give it another name, with an ending such as .nc"
        raise UsageError(Diagnostic("job-name", message, hint=hint))
    return name


def unfit_macro(message: str, hint: str) -> UsageError:
    """Return the refusal of a macro."""
    return UsageError(Diagnostic("macro-unfit", message, hint=hint))


class TextLines:
    """The lines of one text file, found by an index of every 1000th line.

    Attributes:
        total: Number of lines.
    """

    STRIDE = 1000

    def __init__(self, file: Path) -> None:
        self.file, self.changed = file, file.stat().st_mtime_ns
        self._starts, count, at, ends_open = [0], 0, 0, False
        with file.open("rb") as source:
            while piece := source.read(PIECE):
                found = -1
                while (found := piece.find(b"\n", found + 1)) >= 0:
                    count += 1
                    if count % self.STRIDE == 0:
                        self._starts.append(at + found + 1)
                at += len(piece)
                ends_open = not piece.endswith(b"\n")
        self.total = count + ends_open

    def lines(self, first: int, count: int) -> list[str]:
        """Return at most ``count`` lines from line ``first``, from 1."""
        if first > self.total:
            return []
        block, skipped = divmod(first - 1, self.STRIDE)
        with self.file.open("rb") as source:
            source.seek(self._starts[min(block, len(self._starts) - 1)])
            for _ in range(skipped):
                source.readline()
            wanted = min(count, self.total - first + 1)
            return [
                source.readline().decode("utf-8", "replace").rstrip("\r\n") for _ in range(wanted)
            ]

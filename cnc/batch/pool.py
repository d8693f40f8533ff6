"""Checks many programs in several processes, so that neither a fault nor the death of one stops the
rest.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from cnc.batch.task import Prepare, Task
from cnc.machine.models import Machine
from cnc.model.diagnostics import CncError, Diagnostic, UsageError
from cnc.report.result import Report
from cnc.session.options import RunOptions
from cnc.session.source import STANDARD_INPUT

ATTEMPTS = 2
"""A program whose worker dies is tried again: it may have been another's memory that was wanted."""
PATIENCE = 2.0
"""Seconds in which a worker that is no longer needed may tidy up."""

START = f"import sys; sys.path.append({str(Path(__file__).parents[2])!r}); from cnc.batch.worker import main; main()"
"""Modules that lie in the working directory, beside the programs, are not imported (python -P)."""


def cores() -> int:
    """How many processes can run at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_many(
    programs: Sequence[str],
    machine: Machine,
    options: RunOptions | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    on_done: Callable[[int], None] | None = None,
    on_compiling: Callable[[], None] | None = None,
) -> Iterator[Report]:
    """Yield a report of each program, in their order, as :func:`cnc.api.check` gives it.

    jobs: how many processes, None for one a core. scheduler: the address of a Dask cluster's, whose
    workers take their place. on_done: told how many programs have been checked, in whatever order.
    A program whose process dies, again and again, has the fault ``worker-died``; one that cncrun
    fails at, ``internal-error``. Raises what is wrong with no single program: UsageError,
    MachineFileError.
    """
    if jobs is not None and jobs < 1:
        raise UsageError(
            Diagnostic(
                "job-count", f"{jobs} processes can't check anything", hint="give --jobs 1 or more"
            )
        )
    tasks = [Task(program, machine, options or RunOptions()) for program in programs]
    if scheduler is None:
        outcomes = _at_home(tasks, min(jobs or cores(), len(tasks)), on_compiling or (lambda: None))
    else:
        from cnc.batch.dask_cluster import check_on

        outcomes = check_on(scheduler, tasks)
    finished: dict[int, Report | CncError] = {}
    with closing(outcomes):
        count = 0
        for index in range(len(tasks)):
            while index not in finished:
                number, outcome = next(outcomes)
                finished[number] = outcome
                count += 1
                if on_done is not None:
                    on_done(count)
            found = finished.pop(index)
            if isinstance(found, CncError):
                raise found
            yield found


def _at_home(
    tasks: Sequence[Task], hands: int, on_compiling: Callable[[], None]
) -> Generator[tuple[int, Report | CncError]]:
    """Number and outcome of each task, as they come, from processes of this computer."""
    crew = _Crew(tasks, hands, on_compiling)
    try:
        while True:
            yield crew.done.get()
    finally:
        crew.dismiss()


class _Crew:
    """Threads, each with a worker process of its own, that take tasks by number and put outcomes
    into ``done``.
    """

    def __init__(self, tasks: Sequence[Task], hands: int, on_compiling: Callable[[], None]) -> None:
        self.done: SimpleQueue[tuple[int, Report | CncError]] = SimpleQueue()
        self._todo: SimpleQueue[tuple[int, Task]] = SimpleQueue()
        for numbered in enumerate(tasks):
            self._todo.put(numbered)
        self._on_compiling = on_compiling
        self._preparing = threading.Lock()
        self._workers = [_Worker(self._prepare) for _ in range(hands)]
        for worker in self._workers:
            threading.Thread(target=self._work, args=(worker,), daemon=True).start()

    def _work(self, worker: _Worker) -> None:
        with suppress(Empty, _Dismissed):
            while True:
                number, task = self._todo.get_nowait()
                self.done.put(
                    (
                        number,
                        self._from_standard_input(task)
                        if task.program == STANDARD_INPUT
                        else worker.check(task),
                    )
                )

    def _prepare(self, process: subprocess.Popen[bytes]) -> None:
        """Let one worker compile the kernels; the others find what it made."""
        with self._preparing:
            _ask(process, Prepare())
            while _answer(process) is not None:
                self._on_compiling()

    def _from_standard_input(self, task: Task) -> Report | CncError:
        """A worker has no standard input but its tasks."""
        from cnc.session.kernel_cache import ensure_compiled

        with self._preparing:
            ensure_compiled(self._on_compiling)
        return task.perform()

    def dismiss(self) -> None:
        """End what is under way; workers that are in the middle of something have a moment to tidy
        up.
        """
        with suppress(Empty):
            while True:
                self._todo.get_nowait()
        for worker in self._workers:
            worker.dismiss()
        for worker in self._workers:
            worker.wait()


class _Dismissed(Exception):
    """Nobody wants to know any more."""


class _Worker:
    """A process for one task at a time, started when there is one, and anew when it has died."""

    def __init__(self, prepare: Callable[[subprocess.Popen[bytes]], None]) -> None:
        self._prepare = prepare
        self._process: subprocess.Popen[bytes] | None = None
        self._dismissed = False
        self._changing = threading.Lock()

    def check(self, task: Task) -> Report | CncError:
        """The outcome of a task, whatever happens to the process."""
        end = ""
        for _ in range(ATTEMPTS):
            known = self._process
            process = known or self._start()
            try:
                if known is None:
                    self._prepare(process)
                _ask(process, task)
                outcome: Report | CncError = _answer(process)
                return outcome
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                # ValueError: its streams were closed, for nobody needs it any more
                end = _end_of(process)
                self._process = None
        message = f"the process that checked it {end}, {ATTEMPTS} times"
        return task.failed(
            "worker-died",
            message,
            "check this program alone, and with more memory; report it if that does not help",
        )

    def _start(self) -> subprocess.Popen[bytes]:
        with self._changing:
            if self._dismissed:
                raise _Dismissed
            command = [sys.executable, "-P", "-c", START]
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
            )
            return self._process

    def dismiss(self) -> None:
        """Tell the process that it is not needed any more."""
        with self._changing:
            self._dismissed = True
            if self._process is not None and self._process.stdin is not None:
                with suppress(OSError):
                    self._process.stdin.close()

    def wait(self) -> None:
        """Return when the process is gone."""
        process = self._process
        if process is not None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE)
            _end_of(process)


def _ask(process: subprocess.Popen[bytes], question: Prepare | Task) -> None:
    assert process.stdin
    pickle.dump(question, process.stdin)
    process.stdin.flush()


def _answer(process: subprocess.Popen[bytes]) -> Any:
    """What a worker of ours says; EOFError if it is gone."""
    assert process.stdout
    return pickle.load(process.stdout)


def _end_of(process: subprocess.Popen[bytes]) -> str:
    """How a process that does not answer ended, or ends now."""
    process.kill()
    code = process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):
                stream.close()
    if code >= 0:
        return f"ended with code {code}"
    return f"was ended by signal {-code} ({signal.strsignal(-code)})"

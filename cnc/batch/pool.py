"""Checks of many programs in several processes. The death of one does not stop the others."""

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
from cnc.model.diagnostics import CncError, Diagnostic, UsageError
from cnc.report.result import Report
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.kernel_jobs import CHECKING
from cnc.session.program_reader import STANDARD_INPUT

ATTEMPTS = 2
"""Attempts for a program whose worker dies: another program may have used the memory."""
END_TIMEOUT = 2.0
"""Seconds that a worker has to end by itself."""

START = (
    f"import sys; sys.path.append({str(Path(__file__).parents[2])!r}); "
    "from cnc.batch.task import main; main()"
)
"""Code of a worker. It runs with ``python -P``, which ignores modules beside the programs."""


def cores() -> int:
    """Return the number of processes that can run at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_tasks(
    tasks: Sequence[Task],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    on_compiling: Callable[[], None] | None = None,
) -> Iterator[Report]:
    """Check programs, each with its machine and options, and yield their reports in that order.

    A program whose process dies repeatedly has the fault ``worker-died``. A fault of cncrun itself
    is ``internal-error``.

    Args:
        tasks: the programs.
        jobs: number of processes; None for one on each core.
        scheduler: address of a Dask scheduler, whose workers replace the processes.
        on_compiling: called when a worker compiles the kernels.

    Raises:
        UsageError: the options are wrong for every program.
        MachineFileError: the machine file is wrong.
        BoardError: ``farm-lost``.
    """
    if jobs is not None and jobs < 1:
        raise UsageError(
            Diagnostic(
                "job-count", f"{jobs} processes cannot check programs", hint="use --jobs 1 or more"
            )
        )
    if scheduler is None:
        outcomes = _check_locally(
            tasks, min(jobs or cores(), len(tasks)), on_compiling or (lambda: None)
        )
    else:
        from cnc.batch.dask_cluster import check_on  # a cluster is rare

        outcomes = check_on(scheduler, tasks)
    finished: dict[int, Report | CncError] = {}
    with closing(outcomes):
        for index in range(len(tasks)):
            while index not in finished:
                number, outcome = next(outcomes)
                finished[number] = outcome
            outcome_due = finished.pop(index)
            if isinstance(outcome_due, CncError):
                raise outcome_due
            yield outcome_due


def _check_locally(
    tasks: Sequence[Task], jobs: int, on_compiling: Callable[[], None]
) -> Generator[tuple[int, Report | CncError]]:
    """Yield the index and the outcome of each task from processes of this computer."""
    pool = _Pool(tasks, jobs, on_compiling)
    try:
        while True:
            yield pool.done.get()
    finally:
        pool.dismiss()


class _Pool:
    """Threads with one worker process each. They put (index, outcome) of tasks into ``done``."""

    def __init__(self, tasks: Sequence[Task], jobs: int, on_compiling: Callable[[], None]) -> None:
        self.done: SimpleQueue[tuple[int, Report | CncError]] = SimpleQueue()
        self._todo: SimpleQueue[tuple[int, Task]] = SimpleQueue()
        for numbered in enumerate(tasks):
            self._todo.put(numbered)
        self._on_compiling = on_compiling
        self._preparing = threading.Lock()
        self._workers = [_Worker(self._prepare) for _ in range(jobs)]
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
        """Let one worker compile the kernels; the others load the result."""
        with self._preparing:
            _ask(process, Prepare())
            while _answer(process) is not None:
                self._on_compiling()

    def _from_standard_input(self, task: Task) -> Report | CncError:
        """Check standard input here: that of a worker transfers its tasks."""
        with self._preparing:
            ensure_compiled(self._on_compiling, jobs=CHECKING)
        return task.perform()

    def dismiss(self) -> None:
        """End all work. Workers have a moment to end by themselves."""
        with suppress(Empty):
            while True:
                self._todo.get_nowait()
        for worker in self._workers:
            worker.dismiss()
        for worker in self._workers:
            worker.wait()


class _Dismissed(Exception):
    """The outcome is no longer needed."""


class _Worker:
    """A process for one task at a time. It is started when needed, and again after its death."""

    def __init__(self, prepare: Callable[[subprocess.Popen[bytes]], None]) -> None:
        self._prepare = prepare
        self._process: subprocess.Popen[bytes] | None = None
        self._dismissed = False
        self._changing = threading.Lock()

    def check(self, task: Task) -> Report | CncError:
        """Return the outcome of a task, also if the process dies."""
        end = ""
        for _ in range(ATTEMPTS):
            running = self._process
            process = running or self._start()
            try:
                if running is None:
                    self._prepare(process)
                _ask(process, task)
                outcome: Report | CncError = _answer(process)
                return outcome
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                # ValueError: the streams were closed by dismiss().
                end = _end_of(process)
                self._process = None
        message = f"the process that checked it {end}, {ATTEMPTS} times"
        return task.failed(
            "worker-died",
            message,
            "check this program alone, with more memory; report it if that does not help",
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
        """Close the input of the process, so that it ends."""
        with self._changing:
            self._dismissed = True
            if self._process is not None and self._process.stdin is not None:
                with suppress(OSError):
                    self._process.stdin.close()

    def wait(self) -> None:
        """Wait until the process has ended, or kill it."""
        process = self._process
        if process is not None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(END_TIMEOUT)
            _end_of(process)


def _ask(process: subprocess.Popen[bytes], question: Prepare | Task) -> None:
    assert process.stdin
    pickle.dump(question, process.stdin)
    process.stdin.flush()


def _answer(process: subprocess.Popen[bytes]) -> Any:
    """Return the next answer of a worker. Raises EOFError if it has ended."""
    assert process.stdout
    return pickle.load(process.stdout)


def _end_of(process: subprocess.Popen[bytes]) -> str:
    """Kill a process that does not answer, and return how it ended."""
    process.kill()
    code = process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):
                stream.close()
    if code >= 0:
        return f"ended with code {code}"
    return f"was ended by signal {-code} ({signal.strsignal(-code)})"

"""Checks on a Dask cluster: each program goes to a worker with its text, and its report comes back.

        here                       scheduler              workers (each with this version of cncrun)
      read, pack ── task + text ──►  keeps it  ──────────►  check
      unpack     ◄── report ───────  till it is done  ◄───  report

If a worker dies, the scheduler gives its task to another. A program at which several workers die is
``worker-died``. Each task has one future with one outcome, so that every program is reported once.
"""

from __future__ import annotations

import logging
import pickle
import uuid
import warnings
import zlib
from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from typing import Any

from cnc.batch.task import Task
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, UsageError
from cnc.report.result import Report
from cnc.session.program_reader import InlineProgram, display_name, readable_file
from cnc.version import __version__

TIMEOUT = 10.0
"""Seconds within which a scheduler must answer."""
TASKS_PER_THREAD = 2
"""Tasks submitted for each thread of the cluster. The texts of the others stay here."""
MIN_TASKS = 8
"""Tasks that are submitted to any cluster."""


def perform(packed: bytes, version: str) -> bytes:
    """Check a packed task on a worker and return its packed outcome.

    Args:
        packed: the task, pickled and compressed.
        version: version of cncrun that submitted it.
    """
    if version != __version__:
        message = f"a worker has cncrun {__version__}, this computer has {version}"
        fault = UsageError(
            Diagnostic("farm-version", message, hint="install the same version everywhere")
        )
        return zlib.compress(pickle.dumps(fault))
    task: Task = pickle.loads(zlib.decompress(packed))
    return zlib.compress(pickle.dumps(task.perform()), 1)


def check_on(address: str, tasks: Sequence[Task]) -> Generator[tuple[int, Report | CncError]]:
    """Yield the index and the outcome of each task, in the order in which they finish.

    Raises:
        UsageError: ``farm-missing``, ``farm-unreachable``, ``farm-version``,
            ``farm-without-cncrun``.
        BoardError: ``farm-lost`` when the connection to the scheduler breaks.
    """
    distributed, client = _connected(address)
    numbers: dict[Any, int] = {}
    waiting = iter(enumerate(tasks))
    run = uuid.uuid4().hex
    try:
        pending = distributed.as_completed(loop=client.loop)
        while True:
            free = max(MIN_TASKS, TASKS_PER_THREAD * sum(client.nthreads().values())) - len(numbers)
            while free > 0 and (following := next(waiting, None)) is not None:
                number, task = following
                try:
                    packed = _packed(task)
                except CncError as error:
                    yield number, task.with_fault(error)
                    continue
                future = _submitted(client, packed, f"cncrun-{run}-{number}")
                numbers[future] = number
                pending.add(future)
                free -= 1
            if not numbers:
                return
            future = next(pending)
            number = numbers.pop(future)
            yield number, _outcome(distributed, future, tasks[number])
    except (OSError, TimeoutError) as error:
        message = f"the connection to the scheduler {address} broke: {error}"
        hint = "make sure that the scheduler runs, and start the check again"
        raise BoardError(Diagnostic("farm-lost", message, hint=hint)) from error
    finally:
        with suppress(Exception):
            client.cancel(list(numbers), force=True)
        with suppress(Exception):
            client.close(timeout=TIMEOUT)


def _connected(address: str) -> tuple[Any, Any]:
    try:
        distributed: Any = import_module("distributed")
    except ImportError as error:
        raise UsageError(
            Diagnostic(
                "farm-missing",
                "--scheduler needs Dask, which is not installed",
                hint="pip install 'cncrun[farm]'",
            )
        ) from error
    # Its log about workers that come and go is not for standard error; faults become findings.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        return distributed, distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        hint = "give the address that `dask scheduler` shows, such as tcp://host:8786"
        raise UsageError(
            Diagnostic(
                "farm-unreachable", f"no scheduler answers at {address}: {reason}", hint=hint
            )
        ) from error


def _packed(task: Task) -> bytes:
    """Return a packed task with the text of its program. Raises CncError if it is unreadable."""
    with readable_file(task.program) as path:
        text = path.read_bytes()
    return zlib.compress(
        pickle.dumps(replace(task, program=InlineProgram(display_name(task.program), text))), 1
    )


def _submitted(client: Any, packed: bytes, key: str) -> Any:
    with warnings.catch_warnings():
        # Dask warns of large arguments, but the text of a program belongs to its task.
        warnings.filterwarnings("ignore", message=".*[Ll]arge", category=UserWarning)
        return client.submit(perform, packed, __version__, key=key, pure=False)


def _outcome(distributed: Any, future: Any, task: Task) -> Report | CncError:
    try:
        answer: bytes = future.result(timeout=TIMEOUT)
    except distributed.KilledWorker:
        hint = "check this program alone, with more memory; report it if that does not help"
        return task.failed("worker-died", "the workers that checked it died repeatedly", hint)
    except ModuleNotFoundError as error:
        hint = f"install cncrun {__version__} where the workers run"
        return UsageError(
            Diagnostic("farm-without-cncrun", f"a worker cannot check programs: {error}", hint=hint)
        )
    except (OSError, TimeoutError):
        raise
    except Exception as error:
        message = f"the cluster failed to check it: {type(error).__name__}: {error}"
        return task.failed(
            "internal-error",
            message,
            "please report the program, the machine file and this message",
        )
    outcome: Report | CncError = pickle.loads(zlib.decompress(answer))
    return outcome

"""Hands the programs to a Dask cluster: each goes to a worker with its text, its report comes back,
in whatever order.

        here                       scheduler              workers (each with this version of cncrun)
      read, pack ── task + text ──►  keeps it  ──────────►  check
      unpack     ◄── report ───────  till it is done  ◄───  report

When a worker dies the scheduler gives its task to another; a program at which workers die again and
again is ``worker-died``. Every task has one future, which has one outcome: nothing is lost, and
nothing is told twice.
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

from cnc import __version__
from cnc.batch.task import Task
from cnc.model.diagnostics import BoardError, CncError, Diagnostic, UsageError
from cnc.report.result import Report
from cnc.session.source import Shipped, readable, shown_name

PATIENCE = 10.0
"""Seconds in which a scheduler has to answer."""
AHEAD = 2
"""Tasks under way for each thread of the cluster: the texts of the others stay here."""
LEAST_AHEAD = 8


def perform(packed: bytes, version: str) -> bytes:
    """On a worker: check a packed task; what came of it, packed."""
    if version != __version__:
        message = f"a worker has version {__version__} of cncrun, this is {version}"
        fault = UsageError(
            Diagnostic("farm-version", message, hint="install the same version everywhere")
        )
        return zlib.compress(pickle.dumps(fault))
    task: Task = pickle.loads(zlib.decompress(packed))
    return zlib.compress(pickle.dumps(task.perform()), 1)


def check_on(address: str, tasks: Sequence[Task]) -> Generator[tuple[int, Report | CncError]]:
    """Yield number and outcome of each task, as they come.

    UsageError ``farm-missing``, ``farm-unreachable``, ``farm-version``, ``farm-without-cncrun``;
    BoardError ``farm-lost`` when the link to the scheduler breaks.
    """
    distributed, client = _connected(address)
    numbers: dict[Any, int] = {}
    waiting = iter(enumerate(tasks))
    run = uuid.uuid4().hex
    try:
        pending = distributed.as_completed(loop=client.loop)
        while True:
            room = max(LEAST_AHEAD, AHEAD * sum(client.nthreads().values())) - len(numbers)
            while room > 0 and (following := next(waiting, None)) is not None:
                number, task = following
                try:
                    packed = _packed(task)
                except CncError as error:
                    yield number, task.with_fault(error)
                    continue
                future = _submitted(client, packed, f"cncrun-{run}-{number}")
                numbers[future] = number
                pending.add(future)
                room -= 1
            if not numbers:
                return
            future = next(pending)
            number = numbers.pop(future)
            yield number, _outcome(distributed, future, tasks[number])
    except (OSError, TimeoutError) as error:
        message = f"the link to the scheduler {address} broke: {error}"
        raise BoardError(
            Diagnostic("farm-lost", message, hint="see whether it still runs, and begin anew")
        ) from error
    finally:
        with suppress(Exception):
            client.cancel(list(numbers), force=True)
        with suppress(Exception):
            client.close(timeout=PATIENCE)


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
    # what it logs about workers that come and go is not for standard error: what matters becomes a
    # finding
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        return distributed, distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        hint = "give the address that `dask scheduler` shows, such as tcp://host:8786"
        raise UsageError(
            Diagnostic(
                "farm-unreachable", f"no scheduler answers at {address}: {reason}", hint=hint
            )
        ) from error


def _packed(task: Task) -> bytes:
    """A task with the text of its program; CncError if that can't be read."""
    with readable(task.program) as path:
        text = path.read_bytes()
    return zlib.compress(
        pickle.dumps(replace(task, program=Shipped(shown_name(task.program), text))), 1
    )


def _submitted(client: Any, packed: bytes, key: str) -> Any:
    with warnings.catch_warnings():
        # A text is large for what Dask takes for an argument; where else should it be kept, but
        # with its task?
        warnings.filterwarnings("ignore", message=".*[Ll]arge", category=UserWarning)
        return client.submit(perform, packed, __version__, key=key, pure=False)


def _outcome(distributed: Any, future: Any, task: Task) -> Report | CncError:
    try:
        answer: bytes = future.result(timeout=PATIENCE)
    except distributed.KilledWorker:
        hint = "check this program alone, and with more memory; report it if that does not help"
        return task.failed("worker-died", "the workers that checked it died, again and again", hint)
    except ModuleNotFoundError as error:
        hint = f"install cncrun {__version__} where the workers run"
        return UsageError(
            Diagnostic("farm-without-cncrun", f"a worker can't check programs: {error}", hint=hint)
        )
    except (OSError, TimeoutError):
        raise
    except Exception as error:
        message = f"the farm failed at it: {type(error).__name__}: {error}"
        return task.failed(
            "internal-error",
            message,
            "please report the program, the machine file and this message",
        )
    outcome: Report | CncError = pickle.loads(zlib.decompress(answer))
    return outcome

"""Worker process: it reads tasks from standard input and writes reports to standard output."""

from __future__ import annotations

import _thread
import os
import pickle
import threading
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any

from cnc.batch.task import Compiling, Prepare, Task
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.kernel_jobs import CHECKING

Tasks = SimpleQueue[Prepare | Task | None]


def main() -> None:
    """Answer requests until standard input ends."""
    # A library that prints must not write between the answers.
    source, target = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "r+b") as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(nothing.fileno(), 1)
    tasks: Tasks = SimpleQueue()
    with suppress(KeyboardInterrupt, BrokenPipeError):
        threading.Thread(target=_listen, args=(source, tasks), daemon=True).start()
        while (task := tasks.get()) is not None:
            if isinstance(task, Prepare):
                ensure_compiled(lambda: _answer(target, Compiling()), jobs=CHECKING)
                _answer(target, None)
            else:
                _answer(target, task.perform())


def _listen(source: IO[bytes], tasks: Tasks) -> None:
    """Pass requests on. When the calling process has ended, interrupt the check under way."""
    with suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            tasks.put(pickle.load(source))
    tasks.put(None)
    _thread.interrupt_main()


def _answer(target: IO[bytes], answer: Any) -> None:
    pickle.dump(answer, target)
    target.flush()

"""A process that checks one program after another: tasks come in by standard input, reports go out
by standard output.
"""

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

Tasks = SimpleQueue[Prepare | Task | None]


def main() -> None:
    """Answer until nobody asks any more."""
    # Both streams are ours alone: a library that prints must not garble the answers.
    source, target = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "r+b") as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(nothing.fileno(), 1)
    tasks: Tasks = SimpleQueue()
    with suppress(KeyboardInterrupt, BrokenPipeError):
        threading.Thread(target=_listen, args=(source, tasks), daemon=True).start()
        while (task := tasks.get()) is not None:
            if isinstance(task, Prepare):
                ensure_compiled(lambda: _answer(target, Compiling()))
                _answer(target, None)
            else:
                _answer(target, task.perform())


def _listen(source: IO[bytes], tasks: Tasks) -> None:
    """Pass on what comes. When the asking process is gone, in whatever way, nobody waits for what
    is under way.
    """
    with suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            tasks.put(pickle.load(source))
    tasks.put(None)
    _thread.interrupt_main()


def _answer(target: IO[bytes], answer: Any) -> None:
    pickle.dump(answer, target)
    target.flush()

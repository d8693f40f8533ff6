"""Compilation of the kernels that a program needs, before anything moves.

Kernels are compiled by worker processes, one for each processor. A worker compiles by calling: each
job is a small example that calls the kernels of some modules. All other kernels of the example run
as plain Python. Compiled code is kept on disk (:mod:`cnc.compiled.code_cache`), where each process
finds the code of the others, and waits for a kernel that another process compiles. A file for each
job records that it was done.
"""

from __future__ import annotations

import gc
import hashlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from cnc.compiled import code_cache
from cnc.compiled.jit import as_python, compiling
from cnc.compiled.kernel import Kernel, kernels, watchers
from cnc.session.kernel_jobs import JOBS

OnKernel = Callable[[int, int, str], None]
"""Called with the number of kernels compiled so far, the number of all, and the next one's name."""

SMALL_BYTES = 16_384
"""A program up to this size is read without compiled kernels while there are none."""


def ensure_compiled(
    on_compiling: Callable[[], None] | None = None,
    on_kernel: OnKernel | None = None,
    jobs: Iterable[str] = JOBS,
) -> None:
    """Compile the kernels of some jobs unless this computer has them.

    Args:
        on_compiling: called before anything is compiled.
        on_kernel: called before each kernel is compiled.
        jobs: names of the jobs, in any order; all by default.
    """
    wanted = set(jobs)
    missing = [name for name in JOBS if name in wanted and not is_compiled(name)]
    if not missing:
        return
    if on_compiling is not None:
        on_compiling()
    total = len(_missing_kernels(missing))
    for done, label in enumerate(_compiled_by_workers(missing)):
        if on_kernel is not None:
            on_kernel(done, max(done + 1, total), label)


def load_kernels(jobs: Iterable[str]) -> None:
    """Load the kernels of some jobs into this process, compiled, so that no first motion waits."""
    wanted = set(jobs)
    ensure_compiled(None, None, wanted)
    if compiling():
        for job in wanted:
            _call_example(job)


def _call_example(job: str) -> None:
    """Call the kernels of a job."""
    from cnc.session import kernel_examples  # it imports all that has kernels

    getattr(kernel_examples, JOBS[job].example)()


def is_compiled(job: str) -> bool:
    """Return whether the kernels of a job are on disk, or kernels run as plain Python."""
    if not compiling():
        return True
    places = code_cache.SHIPPED, code_cache.cache_folder()
    # The marks of this text and processor have names that need the import of the loader.
    return any(_has_mark(place, job) for place in places) and any(
        mark.exists() for mark in _marks(job)
    )


def _has_mark(place: Path, job: str) -> bool:
    """Return whether a folder has a record of the job, for whatever text and processor."""
    with suppress(OSError):
        beginning = f"{_file_name(job)}-"
        return any(
            each.startswith(beginning) and each.endswith(".done") for each in os.listdir(place)
        )
    return False


def _file_name(job: str) -> str:
    return job.replace(" ", "-")


def _marks(job: str) -> list[Path]:
    """Return the files that record the job: beside installed code, and on this computer."""
    from cnc.compiled.loader import PORTABLE, host, version

    files = [Path(import_module(name).__file__ or "") for name in sorted(JOBS[job].modules)]
    # Another example may call kernels with other types.
    files.append(Path(__file__).with_name("kernel_examples.py"))
    names = [code_cache.folder_name(file) for file in files]
    places = (code_cache.SHIPPED, PORTABLE), (code_cache.cache_folder(), host())
    marks = []
    for folder, processor in places:
        key = hashlib.sha256(repr((names, version(processor))).encode()).hexdigest()[:16]
        marks.append(folder / f"{_file_name(job)}-{key}.done")
    return marks


def _missing_kernels(jobs: Sequence[str]) -> list[Kernel]:
    """Return the kernels of some jobs, and those that they call, that are not on disk."""
    for job in jobs:
        for name in JOBS[job].modules:
            import_module(name)
    modules = {name for job in jobs for name in JOBS[job].modules}
    waiting = [kernel for kernel in kernels.values() if kernel.__module__ in modules]
    found: dict[Kernel, None] = {}
    while waiting:
        kernel = waiting.pop()
        if kernel not in found:
            found[kernel] = None
            waiting += kernel.callees()
    return [kernel for kernel in found if not kernel.is_on_disk]


def _compiled_by_workers(jobs: Sequence[str]) -> Iterator[str]:
    """Compile the kernels of the jobs; yield the name of each when its compilation begins.

    Workers end when this process ends, or the iteration is given up.
    """
    todo: queue.SimpleQueue[str] = queue.SimpleQueue()
    for job in jobs:
        todo.put(job)
    lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    workers = [_Worker(todo, lines) for _ in range(min(len(jobs), os.cpu_count() or 1))]
    working = len(workers)
    try:
        while working:
            with suppress(queue.Empty):
                # On Windows, Ctrl-C does not interrupt a wait without an end.
                line = lines.get(timeout=0.5)
                if line is None:
                    working -= 1
                else:
                    yield line
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process that does one job after the other.

    Args:
        todo: the jobs.
        lines: receives the name of each kernel, and None when there are no more jobs.
    """

    def __init__(self, todo: queue.SimpleQueue[str], lines: queue.SimpleQueue[str | None]) -> None:
        self._todo, self._lines = todo, lines
        self._process = subprocess.Popen(
            [sys.executable, "-m", "cnc.session.kernel_cache"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=os.environ | {"NUMBA_CACHE_DIR": str(code_cache.cache_folder())},
        )
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the process. Nothing is half written."""
        self._process.kill()
        self._process.wait()
        self._thread.join()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                assert pipe is not None
                pipe.close()

    def _work(self) -> None:
        source, target = self._process.stdin, self._process.stdout
        assert source is not None and target is not None
        with suppress(queue.Empty, OSError, ValueError):
            while True:
                source.write(self._todo.get_nowait() + "\n")
                source.flush()
                while (line := target.readline().rstrip("\n")) != DONE:
                    if not line:
                        raise BrokenPipeError
                    self._lines.put(line)
        self._lines.put(None)


DONE = "."
"""The line by which a worker reports the end of a job."""


def work() -> None:
    """Do the jobs that standard input names, one a line."""
    # The compiler makes no cycles worth collecting; looking for them takes a fifth of the time.
    gc.disable()
    # numba imports SciPy where there is one, for products of matrices. Kernels have none, since
    # they are compiled without SciPy, too.
    sys.modules.setdefault("scipy", None)  # type: ignore[arg-type]
    watchers.append(lambda kernel: _tell(kernel.label))
    requests: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests,), daemon=True).start()
    while True:
        job = requests.get()
        with suppress(Exception):  # it is compiled again where it is called, and fails there
            compile_job(job)
        _tell(DONE)


def _tell(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def compile_job(job: str) -> None:
    """Compile the kernels of a job, and record that."""
    with as_python(except_in=JOBS[job].modules):
        _call_example(job)
    mark = _marks(job)[-1]
    code_cache.write(mark.parent, mark.name, b"")


def _listen(requests: queue.SimpleQueue[str]) -> None:
    """Pass requests on; end the process when standard input ends, with the calling process."""
    for line in sys.stdin:
        requests.put(line.strip())
    os._exit(1)


if __name__ == "__main__":
    work()

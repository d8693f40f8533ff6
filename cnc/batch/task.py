"""Messages between the calling process and its workers; they are pickled."""

from __future__ import annotations

import _thread
import os
import pickle
import threading
from contextlib import suppress
from dataclasses import dataclass
from queue import SimpleQueue
from typing import IO, Any

from cnc.machine.models import Machine
from cnc.model.diagnostics import CncError, Diagnostic
from cnc.report.result import Extremes, Report
from cnc.session.kernel_cache import ensure_compiled
from cnc.session.kernel_jobs import CHECKING
from cnc.session.options import RunOptions
from cnc.session.program_reader import InlineProgram, display_name
from cnc.session.session import Session


class Prepare:
    """Request to compile the kernels.

    The worker answers :class:`Compiling` if it must compile, and None at the end.
    """


class Compiling:
    """Answer: the worker compiles the kernels, which takes up to a minute."""


@dataclass(frozen=True, slots=True)
class Task:
    """A program to check; see :func:`cnc.api.check`."""

    program: str | InlineProgram
    machine: Machine
    options: RunOptions

    def perform(self) -> Report | CncError:
        """Check the program in this process.

        Returns:
            The report, or the fault of a machine or an option that is wrong for every program.
        """
        try:
            return Session(self.program, self.machine, self.options).run()
        except CncError as error:
            return error
        except Exception as error:
            message = f"cncrun failed: {type(error).__name__}: {error}"
            return self.failed(
                "internal-error",
                message,
                "please report the program, the machine file and this message",
            )

    def failed(self, code: str, message: str, hint: str) -> Report:
        """Return the report of a program that could not be checked."""
        return self.with_fault(
            CncError(Diagnostic(code, message, display_name(self.program), hint=hint))
        )

    def with_fault(self, fault: CncError) -> Report:
        """Return a report with one fault and no other result."""
        return Report(
            display_name(self.program),
            self.machine,
            faults=[fault],
            limits=Extremes.limits(self.machine),
        )


# Worker process: it reads tasks from standard input and writes reports to standard output.

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

"""What goes to a worker and what comes back, both of them pickled."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.machine.models import Machine
from cnc.model.diagnostics import CncError, Diagnostic
from cnc.report.result import Extremes, Report
from cnc.session.options import RunOptions
from cnc.session.source import InlineProgram, display_name


class Prepare:
    """Asks a worker to compile the kernels if need be. The answer: :class:`Compiling` if that takes
    time, and None when it is done.
    """


class Compiling:
    """The worker compiles the kernels; it will take a while."""


@dataclass(frozen=True, slots=True)
class Task:
    """A program to check; see :func:`cnc.api.check`."""

    program: str | InlineProgram
    machine: Machine
    options: RunOptions

    def perform(self) -> Report | CncError:
        """Check the program here; a CncError is for the caller, who named a machine or an option
        that can't be used with any program.
        """
        from cnc.session.session import Session

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
        """The report of a program that nothing can be said about, for no fault of its own."""
        return self.with_fault(
            CncError(Diagnostic(code, message, display_name(self.program), hint=hint))
        )

    def with_fault(self, fault: CncError) -> Report:
        """The report of a program of which nothing is known but what is wrong."""
        return Report(
            display_name(self.program),
            self.machine,
            faults=[fault],
            limits=Extremes.limits(self.machine),
        )

"""Messages between the calling process and its workers; they are pickled."""

from __future__ import annotations

from dataclasses import dataclass

from cnc.machine.models import Machine
from cnc.model.diagnostics import CncError, Diagnostic
from cnc.report.result import Extremes, Report
from cnc.session.options import RunOptions
from cnc.session.source import InlineProgram, display_name


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

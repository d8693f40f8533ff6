"""Messages between the calling process and its workers; they are pickled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cnc.checks.selection import Selection
from cnc.machine.models import DialectName, Machine
from cnc.model.diagnostics import CncError, Diagnostic
from cnc.model.operator_control import Control
from cnc.report.result import Extremes, Report
from cnc.session.source import Shipped, shown_name

if TYPE_CHECKING:
    from cnc.pulses.reference_pulse import Algorithm


class Prepare:
    """Request to compile the kernels.

    The worker answers :class:`Compiling` if it must compile, and None at the end.
    """


class Compiling:
    """Answer: the worker compiles the kernels, which takes about a minute."""


@dataclass(frozen=True, slots=True)
class Task:
    """A program to check; see :func:`cnc.api.check`."""

    program: str | Shipped
    machine: Machine
    dialect: DialectName | None = None
    sampled: bool = False
    feed_override: float = 100.0
    algorithm: Algorithm | None = None
    selection: Selection | None = None
    portable: tuple[str, ...] = ()

    def perform(self) -> Report | CncError:
        """Check the program in this process.

        Returns:
            The report, or the fault of a machine or an option that is wrong for every program.
        """
        from cnc.session import Job, Outputs, Watch

        try:
            control = Control(self.feed_override)
            return Job(
                self.program,
                self.machine,
                self.dialect,
                self.sampled,
                Outputs(),
                Watch(),
                control,
                self.algorithm,
                self.selection,
                self.portable,
            ).carry_out()
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
            CncError(Diagnostic(code, message, shown_name(self.program), hint=hint))
        )

    def with_fault(self, fault: CncError) -> Report:
        """Return a report with one fault and no other result."""
        return Report(
            shown_name(self.program),
            self.machine,
            faults=[fault],
            limits=Extremes.limits(self.machine),
        )

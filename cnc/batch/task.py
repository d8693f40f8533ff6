"""What goes to a worker and what comes back, both of them pickled."""

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
    """Asks a worker to compile the kernels if need be. The answer: :class:`Compiling` if that takes
    time, and None when it is done.
    """


class Compiling:
    """The worker compiles the kernels; it will take a while."""


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
        """Check the program here; a CncError is for the caller, who named a machine or an option
        that can't be used with any program.
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
        """The report of a program that nothing can be said about, for no fault of its own."""
        return self.with_fault(
            CncError(Diagnostic(code, message, shown_name(self.program), hint=hint))
        )

    def with_fault(self, fault: CncError) -> Report:
        """The report of a program of which nothing is known but what is wrong."""
        return Report(
            shown_name(self.program),
            self.machine,
            faults=[fault],
            limits=Extremes.limits(self.machine),
        )

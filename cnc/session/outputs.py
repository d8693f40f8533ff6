"""Output files of a session: each is complete, or it is not there."""

from __future__ import annotations

from typing import TypeVar

from cnc.outputs.targets import STL_SUFFIXES, Output, check_suffixes, suffix_of
from cnc.session.options import Outputs

OutputKind = TypeVar("OutputKind", bound=Output)


def check_outputs(outputs: Outputs) -> None:
    """Raise UsageError ``output-format`` for an unknown suffix."""
    check_suffixes(outputs.trace, outputs.pulses, outputs.lines)
    if outputs.stl is not None:
        suffix_of("stl", outputs.stl, STL_SUFFIXES)
    if outputs.picture is not None:
        from cnc.view.writer import check_picture

        check_picture(outputs.picture)


class OpenOutputs:
    """The output files that are being written."""

    def __init__(self) -> None:
        self._open: list[Output] = []

    def opened(self, output: OutputKind) -> OutputKind:
        """Register an output, so that it is closed with the others, and return it."""
        self._open.append(output)
        return output

    def close(self) -> None:
        """Complete all files."""
        for output in self._open:
            output.close()

    def discard(self) -> None:
        """Remove the files that are not complete."""
        for output in self._open:
            output.discard()

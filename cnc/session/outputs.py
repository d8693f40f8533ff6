"""The files that a job writes: whole, or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from cnc.outputs.targets import Output, check_suffixes
from cnc.view.writer import check_picture


@dataclass(frozen=True, slots=True)
class Outputs:
    """Files to write, ``-`` for standard output, None for none. Formats: see
    :mod:`cnc.outputs`, :mod:`cnc.view.writer`.
    """

    blocks: str | None = None
    trace: str | None = None
    pulses: str | None = None
    lines: str | None = None
    picture: str | None = None

    def check(self) -> None:
        """UsageError ``output-format`` for an unknown suffix."""
        check_suffixes(self.trace, self.pulses, self.lines)
        if self.picture is not None:
            check_picture(self.picture)


OutputKind = TypeVar("OutputKind", bound=Output)


class OpenOutputs:
    """The outputs that are being written."""

    def __init__(self) -> None:
        self._open: list[Output] = []

    def opened(self, output: OutputKind) -> OutputKind:
        """The same, to be closed with the others."""
        self._open.append(output)
        return output

    def close(self) -> None:
        """All is well: the files are complete."""
        for output in self._open:
            output.close()

    def discard(self) -> None:
        """Take back what is not complete."""
        for output in self._open:
            output.discard()

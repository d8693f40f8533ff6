"""The picture as one of the files that are written along the way: in the format that its suffix
names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import Block
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.outputs.targets import BytesTarget, TextTarget
from cnc.planner.plan import PlanChunk
from cnc.report.result import Report
from cnc.view import figure, page
from cnc.view.collect import Collector

SUFFIXES = (".html", ".png", ".svg")


class PictureWriter(Protocol):
    """Takes a plan."""

    def add(self, item: PlanChunk | Block) -> None:
        """A stretch of the plan, or a block between the moves, in their order."""

    def close(self) -> None:
        """Finish the file and put it in place."""

    def discard(self) -> None:
        """Leave what was there before."""


def check_picture(name: str) -> None:
    """UsageError ``output-format`` for a suffix that can't be drawn, ``drawing-missing`` where
    nothing is installed that draws it.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        hint = "name it out.html, or out.png or out.svg for a picture that stands still"
        raise UsageError(
            Diagnostic(
                "output-format", f"the picture is a .html, .png or .svg file, not {name}", hint=hint
            )
        )
    if suffix != ".html":
        try:
            import matplotlib.figure  # noqa: F401
        except ImportError:
            hint = "pip install 'cncrun[view]', or pip install matplotlib; out.html needs nothing"
            raise UsageError(
                Diagnostic(
                    "drawing-missing",
                    f"{suffix} needs matplotlib, which is not installed",
                    hint=hint,
                )
            ) from None


def picture_writer(
    name: str, report: Report, text: Path, start: NDArray[np.float64]
) -> PictureWriter:
    """A picture of the program that ``report`` is on; ``text`` is the file with its text, ``start``
    (axes,) mm where it begins.
    """
    if Path(name).suffix.lower() == ".html":
        return PageWriter(name, report, text, start)
    return FigureWriter(name, report, start)


class PageWriter:
    """An HTML page."""

    def __init__(self, name: str, report: Report, text: Path, start: NDArray[np.float64]) -> None:
        self._report, self._text = report, text
        self._target = TextTarget(name)
        self._collector = Collector(report.machine, page.SIZES, report.program, start)
        self.add = self._collector.add

    def close(self) -> None:
        """Finish the file and put it in place."""
        picture = self._collector.picture()
        texts = [
            (file, self._text if number == 0 else Path(file))
            for number, file in enumerate(picture.files)
        ]
        page.write_page(self._target, picture, self._report, texts)
        self._target.close()

    def discard(self) -> None:
        """Leave what was there before."""
        self._target.discard()


class FigureWriter:
    """A PNG or an SVG."""

    def __init__(self, name: str, report: Report, start: NDArray[np.float64]) -> None:
        self._report = report
        self._target = BytesTarget(name)
        self._collector = Collector(report.machine, figure.SIZES, report.program, start)
        self.add = self._collector.add

    def close(self) -> None:
        """Finish the file and put it in place."""
        kind: Literal["png", "svg"] = "svg" if self._target.name.lower().endswith(".svg") else "png"
        self._target.write(figure.draw(self._collector.picture(), self._report, kind))
        self._target.close()

    def discard(self) -> None:
        """Leave what was there before."""
        self._target.discard()

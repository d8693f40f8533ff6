"""Writers of pictures in the format that the suffix selects."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.report.result import Report
from cnc.report.targets import BytesTarget, TextTarget, Writer
from cnc.view import page
from cnc.view.collect import Collector

SUFFIXES = (".html", ".png", ".svg", ".json")


def check_picture(name: str) -> None:
    """Check that a picture can be drawn.

    Raises:
        UsageError: ``output-format`` for an unknown suffix; ``drawing-missing`` without matplotlib.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        hint = "use out.html for an interactive page, out.png or out.svg for an image"
        raise UsageError(
            Diagnostic(
                "output-format", f"a picture is a .html, .png or .svg file, not {name}", hint=hint
            )
        )
    if suffix in (".png", ".svg"):
        try:
            import matplotlib.figure  # noqa: F401
        except ImportError:
            hint = "pip install 'cncrun[view]', or use out.html, which does not need it"
            raise UsageError(
                Diagnostic(
                    "drawing-missing",
                    f"{suffix} needs matplotlib, which is not installed",
                    hint=hint,
                )
            ) from None


class PageWriter(Writer[TextTarget]):
    """Writes an HTML page."""

    def __init__(self, name: str, report: Report, text: Path, start: NDArray[np.float64]) -> None:
        super().__init__(TextTarget(name))
        self._report, self._text = report, text
        self._collector = Collector(report.machine, page.SIZES, report.program, start)
        self.add = self._collector.add

    def close(self) -> None:
        """Write the page and put it in place."""
        picture = self._collector.picture()
        texts = [
            (file, self._text if number == 0 else Path(file))
            for number, file in enumerate(picture.files)
        ]
        page.write_page(self._target, picture, self._report, texts)
        super().close()


class DataWriter(Writer[TextTarget]):
    """Writes the data of a page as JSON, for a page that has the rest already."""

    def __init__(self, name: str, report: Report, start: NDArray[np.float64]) -> None:
        super().__init__(TextTarget(name))
        self._report = report
        self._collector = Collector(report.machine, page.SIZES, report.program, start)
        self.add = self._collector.add

    def close(self) -> None:
        """Write the data and put the file in place."""
        page.write_data(self._target, self._collector.picture(), self._report)
        super().close()


class FigureWriter(Writer[BytesTarget]):
    """Writes a PNG or an SVG."""

    def __init__(self, name: str, report: Report, start: NDArray[np.float64]) -> None:
        from cnc.view import figure  # it imports matplotlib

        super().__init__(BytesTarget(name))
        self._report, self._draw = report, figure.draw
        self._collector = Collector(report.machine, figure.SIZES, report.program, start)
        self.add = self._collector.add

    def close(self) -> None:
        """Write the image and put it in place."""
        kind: Literal["png", "svg"] = "svg" if self._target.name.lower().endswith(".svg") else "png"
        self._target.write(self._draw(self._collector.picture(), self._report, kind))
        super().close()


PictureWriter = PageWriter | DataWriter | FigureWriter
"""A writer of a picture: it takes the plan in order, item by item."""


def picture_writer(
    name: str, report: Report, text: Path, start: NDArray[np.float64]
) -> PictureWriter:
    """Return a writer for the picture of a program.

    Args:
        name: the file; its suffix selects the format.
        report: the result for the program, complete when the writer is closed.
        text: the file with the text of the program.
        start: (axes,) position at the start, mm.
    """
    suffix = Path(name).suffix.lower()
    if suffix == ".html":
        return PageWriter(name, report, text, start)
    if suffix == ".json":
        return DataWriter(name, report, start)
    return FigureWriter(name, report, start)

"""Writers of pictures in the format that the suffix selects."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cnc.report.result import Report
from cnc.report.targets import BytesTarget, TextTarget, Writer
from cnc.view import page
from cnc.view.collect import Collector


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

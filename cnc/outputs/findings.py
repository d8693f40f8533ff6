"""Findings of many programs in the format of another tool: SARIF, JUnit or GitHub."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from cnc.outputs.github import github
from cnc.outputs.junit import junit
from cnc.outputs.sarif import sarif
from cnc.outputs.targets import STANDARD_OUTPUT, TextTarget
from cnc.report.result import Report

Format = Literal["sarif", "junit", "github"]

_FORMATS: dict[Format, Callable[[Sequence[Report]], str]] = {
    "sarif": sarif,
    "junit": junit,
    "github": github,
}


def write_findings(form: Format, reports: Sequence[Report]) -> None:
    """Write the findings of ``reports`` to standard output."""
    target = TextTarget(STANDARD_OUTPUT)
    target.write(_FORMATS[form](reports))
    target.close()

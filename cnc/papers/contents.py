"""The papers, in the order of the page."""

from __future__ import annotations

from collections.abc import Iterator

from cnc.papers import enclosing_line, half_step, nurbs_lookahead, pulse_rates
from cnc.papers.page import Section


def sections() -> Iterator[Section]:
    """Run the experiments, and yield the section of each paper."""
    yield enclosing_line.section()
    yield nurbs_lookahead.section()
    yield half_step.section()
    yield pulse_rates.section()

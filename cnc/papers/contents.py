"""Which papers there are, in the order of the page."""

from __future__ import annotations

from collections.abc import Iterator

from cnc.papers import half_step, nurbs_lookahead
from cnc.papers.page import Section


def sections() -> Iterator[Section]:
    """Run the experiments, one paper after the other."""
    yield nurbs_lookahead.section()
    yield half_step.section()

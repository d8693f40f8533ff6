"""Formulas of the pages as MathML: browsers draw it without a script, a font or a network.

A formula in TeX stands between two lines of ``$$``. Code hosts draw that form themselves.
"""

from __future__ import annotations

import re
from typing import Any

from latex2mathml.converter import convert

FORMULA = re.compile(r"^\$\$\n(.+?)\n\$\$$", re.MULTILINE | re.DOTALL)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return the text of a page with its formulas as MathML (hook of MkDocs)."""
    return FORMULA.sub(lambda formula: convert(formula[1], display="block"), markdown)

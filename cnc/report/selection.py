"""Which findings a user wants to see: by code, and by comments in the program.

    G1 X5 F99999 (cnc: ignore feed-unreachable)

Errors are always shown: nothing makes a rejected program a good one.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from cnc.errors import Diagnostic

_COMMENT = re.compile(r"[(;]\s*cnc:\s*ignore\s+([a-z0-9][a-z0-9, -]*)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Selection:
    """Codes to show alone (none: all), and codes not to show."""

    select: frozenset[str] = field(default_factory=frozenset)
    ignore: frozenset[str] = field(default_factory=frozenset)

    def wants(self, finding: Diagnostic) -> bool:
        """Whether to show it; ``finding.text`` is its source line, whose comments count."""
        if finding.severity == "error":
            return True
        if finding.code in self.ignore or (self.select and finding.code not in self.select):
            return False
        return finding.code not in ignored_in(finding.text)


def ignored_in(line: str) -> frozenset[str]:
    """The codes that a source line's comments name: ``(cnc: ignore CODE, CODE)``."""
    return frozenset(code for listed in _COMMENT.findall(line) for code in re.split(r"[\s,]+", listed.lower().strip()))

"""The meanings and remedies of findings in other languages, from the gettext files of this folder.

The key of a text is the English one of ``findings.toml``, so a changed text has no translation
until its key is changed too.
"""

from __future__ import annotations

import json
import re
from functools import cache
from importlib import resources

from cnc.checks.selection import Finding, findings

LANGUAGES = ("de",)
_LINE = re.compile(r'(msgid|msgstr)?\s*(".*")')


@cache
def findings_in(language: str) -> dict[str, Finding]:
    """Return the findings by their codes, with meaning and remedy in one of the languages.

    A text without a translation stays English.
    """
    file = resources.files(__package__) / f"{language}.po"
    texts = entries(file.read_text(encoding="utf-8"))
    return {
        code: Finding(
            code,
            texts.get(finding.meaning, finding.meaning),
            texts.get(finding.remedy, finding.remedy),
            finding.severity,
        )
        for code, finding in findings().items()
    }


def entries(text: str) -> dict[str, str]:
    """Return the texts of a gettext file by their English ones."""
    pairs: list[dict[str, str]] = []
    kind = ""
    for line in text.splitlines():
        match = _LINE.fullmatch(line)
        if match is None:
            continue
        kind = match[1] or kind
        if match[1] == "msgid":
            pairs.append({"msgid": "", "msgstr": ""})
        pairs[-1][kind] += json.loads(match[2])
    return {pair["msgid"]: pair["msgstr"] for pair in pairs if pair["msgid"]}

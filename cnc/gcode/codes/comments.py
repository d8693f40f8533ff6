"""Parameter values in the text of DEBUG, PRINT and ABORT comments, and of SINUMERIK's messages.

Source: LinuxCNC, "G-code overview", comment parameters; Siemens, "SINUMERIK 840D sl/828D
Programming Manual, Job Planning", concatenation of strings.
"""

from __future__ import annotations

import re

from cnc.gcode.syntax.parameters import Parameters
from cnc.model.diagnostics import GcodeError

UNKNOWN = "######"
"""Replaces a parameter that does not exist."""
_DEFAULT = ".6f"
_QUOTED = re.compile(r'"([^"]*)"|#<([^<>]*)>')
_PART = re.compile(r"%(?:(d)|\.([0-9])f|(f))|#(?:([0-9]+)|<([^<>]*)>)")


def fill(text: str, parameters: Parameters) -> str:
    """Return the text with values in place of ``#1`` and ``#<name>``.

    ``%d`` (no decimals), ``%f`` (four) and ``%.2f`` are removed and apply to the parameters after
    them. Before the first one, values have six decimals.
    """
    form = _DEFAULT

    def value(part: re.Match[str]) -> str:
        nonlocal form
        whole, decimals, fixed, number, name = part.groups()
        if number is None and name is None:
            form = ".0f" if whole else ".4f" if fixed else f".{decimals}f"
            return ""
        try:
            if number is not None:
                found = parameters.number(float(number), 0)
            else:
                found = parameters.name(re.sub(r"\s", "", name).lower(), 0)
        except GcodeError:
            return UNKNOWN
        return f"{found:{form}}" if found == found else UNKNOWN

    return _PART.sub(value, text)


def shown(text: str, parameters: Parameters) -> str:
    """Return a message of texts in quotes and ``#<name>``: values have 10 decimals at most."""

    def value(part: re.Match[str]) -> str:
        quoted, name = part.groups()
        if name is None:
            return str(quoted)
        try:
            found = parameters.name(name, 0)
        except GcodeError:
            return UNKNOWN
        return f"{found:.10f}".rstrip("0").rstrip(".") if found == found else UNKNOWN

    return _QUOTED.sub(value, text)

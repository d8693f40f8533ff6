"""Text from outside, such as names of files, shown so that it controls nothing.

A terminal obeys control characters. The runner of GitHub obeys lines that begin with ``::``, and
``##[`` anywhere in a line (actions/runner, ``ActionCommand.cs``).
"""

from __future__ import annotations


def printable(text: str) -> str:
    """Return text on one line whose control characters are escapes."""
    if not text.isprintable():
        text = "".join(
            each if each.isprintable() else each.encode("unicode_escape").decode() for each in text
        )
    return text.replace("##[", "#\\x23[")


def shown_name(name: str) -> str:
    """Return the name of a file for the beginning of a line."""
    text = printable(name)
    return f"'{text}'" if text.lstrip().startswith(":") else text


def shown_json(text: str) -> str:
    """Return the same JSON without a command of the runner; ``##[`` occurs in strings alone."""
    return text.replace("##[", "#\\u0023[")

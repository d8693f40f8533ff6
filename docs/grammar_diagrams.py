"""Railroad diagrams of the grammars, for the reference.

Lark's grammar of grammars reads each file of ``grammars/``; railroad-diagrams draws its rules.
"""

from __future__ import annotations

import io
from pathlib import Path

import railroad
from lark import Lark, Token, Transformer, Tree

GRAMMARS = Path(__file__).parents[1] / "grammars"
TITLES = {
    "ngc": "RS274/NGC",
    "macro": "FANUC's custom macro B",
    "sinumerik": "SINUMERIK",
    "klartext": "Heidenhain Klartext",
    "line": "Tokens of RS274/NGC and custom macro B",
}
STYLE = """\
svg.railroad-diagram {background: none; max-width: 100%; height: auto;}
svg.railroad-diagram path {stroke-width: 1.5; stroke: currentColor; fill: none;}
svg.railroad-diagram text {font: 13px monospace; text-anchor: middle; fill: currentColor;}
svg.railroad-diagram rect {stroke-width: 1.5; stroke: currentColor; fill: none;}
"""


class _Drawing(Transformer[Token, railroad.DiagramItem]):
    """Makes the parts of a diagram from those of a rule. Methods are rules of Lark's grammar."""

    def name(self, parts: list[Token]) -> railroad.DiagramItem:
        """Draw the name of another rule, or of a token."""
        text = str(parts[0]).lstrip("_")
        return railroad.NonTerminal(text) if str(parts[0]).islower() else railroad.Terminal(text)

    def literal(self, parts: list[Token]) -> railroad.DiagramItem:
        """Draw a text or a regular expression."""
        return railroad.Terminal(str(parts[0]))

    def maybe(self, parts: list[railroad.DiagramItem]) -> railroad.DiagramItem:
        """Draw a part that may be left out."""
        return railroad.Optional(parts[0])

    def expr(self, parts: list[railroad.DiagramItem | Token]) -> railroad.DiagramItem:
        """Draw a part that may be repeated."""
        if len(parts) == 1:
            return parts[0]
        kinds = {"?": railroad.Optional, "*": railroad.ZeroOrMore, "+": railroad.OneOrMore}
        return kinds[str(parts[1])](parts[0])

    def expansion(self, parts: list[railroad.DiagramItem]) -> railroad.DiagramItem:
        """Draw parts that follow each other."""
        return railroad.Sequence(*parts) if parts else railroad.Skip()

    def alias(self, parts: list[railroad.DiagramItem | Token]) -> railroad.DiagramItem:
        """Draw an alternative; its name is not shown."""
        return parts[0]

    def expansions(self, parts: list[railroad.DiagramItem]) -> railroad.DiagramItem:
        """Draw alternatives."""
        return parts[0] if len(parts) == 1 else railroad.Choice(0, *parts)


def _svg(tree: Tree[Token]) -> str:
    """Return the diagram of a rule or a token."""
    content = tree.children[-1]
    assert isinstance(content, Tree)
    text = io.StringIO()
    railroad.Diagram(_Drawing().transform(content), css=None).writeSvg(text.write)
    # In a block of HTML, brackets are no links.
    return f"<div>{text.getvalue()}</div>"


def page() -> str:
    """Return the page of all grammars."""
    reader = Lark.open_from_package(
        "lark", "lark.lark", ["grammars"], parser="lalr", maybe_placeholders=False
    )
    lines = [
        "# Grammars",
        "",
        "The grammars of the languages that are read, drawn from `grammars/*.lark`. Boxes with",
        "round corners are texts and tokens, the others are rules. Blanks may stand between parts.",
        "",
        f"<style>{STYLE}</style>",
    ]
    for name, title in TITLES.items():
        lines += ["", f"## {title}"]
        text = (GRAMMARS / f"{name}.lark").read_text(encoding="utf-8")
        for part in reader.parse(text + "\n").children:
            if isinstance(part, Tree) and part.data in ("rule", "token"):
                label = str(part.children[0]).lstrip("?!_")
                lines += ["", f"### `{label}`", "", _svg(part)]
    return "\n".join(lines) + "\n"

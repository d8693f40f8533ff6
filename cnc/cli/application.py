"""The application of cyclopts, with a quicker ``--help``."""

from __future__ import annotations

from typing import ClassVar

from cyclopts import App, Parameter
from cyclopts.argument import ArgumentCollection


class Application(App):
    """An application whose options have their texts in ``Parameter(help=...)``."""

    collections: ClassVar[dict[int, ArgumentCollection] | None] = None
    """Options of each command (its ``id``) while help is printed, else None.

    cyclopts assembles them three times to print help: to parse, for the usage, and for the text.
    They are not shared by other command lines, because parsing fills them with values.
    """

    def assemble_argument_collection(
        self,
        *,
        default_parameter: Parameter | None = None,
        parse_docstring: bool = False,
    ) -> ArgumentCollection:
        """Return the options of a command.

        Docstrings have no texts of options, so their source is not searched for them.

        Args:
            default_parameter: Settings of all options.
            parse_docstring: Ignored.
        """
        known = self.collections
        if known is None or default_parameter is not None:
            return super().assemble_argument_collection(default_parameter=default_parameter)
        if id(self) not in known:
            known[id(self)] = super().assemble_argument_collection()
        return known[id(self)]

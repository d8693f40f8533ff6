"""What the commands take alike."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Literal, TextIO

from cyclopts import Parameter

from cnc.model.diagnostics import Diagnostic, UsageError

if TYPE_CHECKING:
    from cyclopts import Token

    from cnc.api import Outputs

HYPHEN = "\0-"
"""Stands for a lone ``-`` while cyclopts parses, which would take it for an option; no argument can
contain it.
"""

Dialect = Literal["auto", "linuxcnc", "grbl", "fanuc", "paper"]
Interpolator = Literal["reference-pulse", "sampled"]
CheckFormat = Literal["text", "json", "sarif", "junit", "github"]
Algorithm = Literal["enclosing-line", "half-step", "point-by-point", "kiritsis", "crossings"]


def option(text: str) -> Parameter:
    """An option that is given or not, without a --no- of its own."""
    return Parameter(help=text, negative="")


def output(text: str) -> Parameter:
    """An option that takes a file, or ``-``."""
    return Parameter(help=text, converter=_file_or_hyphen)


def _file_or_hyphen(_: object, tokens: Sequence[Token]) -> str:
    """The name of a file, or the ``-`` that HYPHEN stands for."""
    return tokens[0].value.replace(HYPHEN, "-")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of run and check alike."""

    machine: Annotated[
        str | None, option("Machine file (TOML), or the name of a shipped one such as paper-nurbs.")
    ] = None
    dialect: Annotated[
        Dialect | None, option("How to read the program; the machine file's choice if left out.")
    ] = None
    interpolator: Annotated[
        Interpolator,
        option(
            "reference-pulse: grid moves alone. sampled: also positions at the machine's period."
        ),
    ] = "reference-pulse"
    algorithm: Annotated[
        Algorithm | None,
        option(
            "How grid moves are made; if left out: half steps on lines and arcs, enclosing lines on other curves."
        ),
    ] = None
    feed_override: Annotated[
        float, option("Per cent of the programmed feeds, 1 to 200; traverses are not scaled.")
    ] = 100.0
    blocks: Annotated[
        str | None,
        output("Write the canonical blocks to FILE.jsonl (- is standard output, here and below)."),
    ] = None
    trace: Annotated[
        str | None,
        output("Write position, feed, acceleration and jerk a period to FILE.npz or FILE.csv."),
    ] = None
    pulses: Annotated[
        str | None, output("Write the grid moves to FILE.npz, or to FILE.vcd for a logic analyser.")
    ] = None
    lines: Annotated[
        str | None,
        output(
            "Write the program as lines for a GRBL board, by our plan, to FILE.nc or FILE.gcode."
        ),
    ] = None
    json: Annotated[str | None, output("Write the summary to FILE.json.")] = None
    quiet: Annotated[bool, option("Say nothing but errors.")] = False
    verbose: Annotated[
        bool,
        option("Say more: each axis's dynamics, computing times, details of an internal error."),
    ] = False

    def check_outputs(
        self, *inputs: str | None, printing: bool = False, picture: str | None = None
    ) -> None:
        """UsageError if two outputs are the same file (``printing``: standard output), or one is
        the machine file or one of ``inputs``.
        """
        read = {
            os.path.realpath(name): name
            for name in (self.machine, *inputs)
            if name is not None and name != "-"
        }
        taken = {"-"} if printing else set()
        for name in (self.blocks, self.trace, self.pulses, self.lines, self.json, picture):
            if name is None:
                continue
            file = name if name == "-" else os.path.realpath(name)
            if file in taken:
                what = "standard output" if name == "-" else name
                raise UsageError(
                    Diagnostic(
                        "output-twice",
                        f"two outputs go to {what}",
                        hint="give each output a file of its own",
                    )
                )
            if file in read:
                raise UsageError(
                    Diagnostic(
                        "output-over-input",
                        f"an output would overwrite {read[file]}",
                        hint="give it another name",
                    )
                )
            taken.add(file)

    def outputs(self) -> Outputs:
        """The files to write along the way."""
        from cnc.api import Outputs

        return Outputs(blocks=self.blocks, trace=self.trace, pulses=self.pulses, lines=self.lines)

    @property
    def summary_file(self) -> TextIO:
        """Where the summary for people goes: standard error if an output has taken standard
        output.
        """
        return (
            sys.stderr
            if "-" in (self.blocks, self.trace, self.pulses, self.lines, self.json)
            else sys.stdout
        )


COMMON = Common()


def library() -> ModuleType:
    """:mod:`cnc.api`. All that it brings along lives as long as the process: the garbage collector
    need not look at it time and again.
    """
    from cnc import api

    gc.freeze()
    return api

"""Options of the commands, and the records that cyclopts fills with them."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal, TextIO

from cyclopts import Group, Parameter, validators

import cnc
from cnc.cli.messages import open_log
from cnc.model.choices import (
    Algorithm,
    Curves,
    DialectName,
    Interpolator,
    TargetName,
    ToolLengths,
    UnknownCodes,
)
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.model.operator_control import Control

if TYPE_CHECKING:
    from cyclopts import Token


HYPHEN = "\0-"
"""Replaces a lone ``-`` while cyclopts parses, which would take it for an option.

No argument of a program can contain it.
"""

CheckFormat = Literal["text", "json", "sarif", "junit", "github"]


DAILY, OTHERS = Group("Daily options", sort_key=1), Group("Options", sort_key=2)
"""The options that most runs need, which help shows first; the others."""


def option(text: str, group: Group | None = None) -> Parameter:
    """Return an option without the negative form ``--no-...``; ``group``: None for the others."""
    if group is None:
        return Parameter(help=text, negative="")
    return Parameter(help=text, negative="", group=group)


def output(text: str) -> Parameter:
    """Return an option that takes a file, or ``-``."""
    return Parameter(help=text, converter=_file_or_hyphen)


def _file_or_hyphen(_: object, tokens: Sequence[Token]) -> str:
    """Return the name of a file, with ``-`` in place of HYPHEN."""
    return tokens[0].value.replace(HYPHEN, "-")


MachineOption = Annotated[
    str | None,
    option("Machine file (TOML), or the name of a shipped one such as paper-nurbs.", DAILY),
]
PortOption = Annotated[str | None, option("Port of the board (/dev/ttyUSB0).")]
BoardOption = Annotated[
    str | None,
    option(
        "loopback, stepper, grbl, grbl-sim, klipper, klipper-sim, file, or an installed driver; "
        "by default the board of the machine file.",
        DAILY,
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class TerminalOptions:
    """Options for messages, of every command that works with a program or a board."""

    quiet: Annotated[bool, option("Print nothing but errors.")] = False
    verbose: Annotated[
        bool,
        Parameter(
            name=["--verbose", "-v"],
            help="Print more: the stages of the run with their times, the dynamics of each axis, "
            "details of an internal error.",
            negative="",
        ),
    ] = False
    log: Annotated[
        str | None,
        option("Write a log to FILE: stages, operator requests, and each line of the link."),
    ] = None

    def open_log(self, *inputs: str | None) -> None:
        """Begin to log. UsageError if the log would overwrite one of ``inputs``."""
        if self.log is not None:
            check_files((self.log,), inputs)
        open_log(self.log, verbose=self.verbose)


TERMINAL = TerminalOptions()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of run, check and view."""

    machine: MachineOption = None
    dialect: Annotated[
        DialectName | None,
        option("How to read the program; by default as the machine file specifies."),
    ] = None
    interpolator: Annotated[
        Interpolator,
        option("reference-pulse: grid moves only. sampled: also positions at a fixed period."),
    ] = "reference-pulse"
    algorithm: Annotated[
        Algorithm | None,
        option(
            "How grid moves follow a curve; by default half steps on lines and arcs, and enclosing "
            "lines on other curves."
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
        output(
            "Write position, feed, acceleration and jerk of each period to FILE.npz or FILE.csv."
        ),
    ] = None
    pulses: Annotated[
        str | None, output("Write the grid moves to FILE.npz, or to FILE.vcd for a logic analyser.")
    ] = None
    lines: Annotated[
        str | None,
        output("Write the planned motion as lines for a GRBL board to FILE.nc or FILE.gcode."),
    ] = None
    json: Annotated[str | None, output("Write the summary to FILE.json.")] = None
    height_map: Annotated[
        str | None,
        option("Raise Z by the height map FILE.json, which cncrun height-map has probed."),
    ] = None
    tool_lengths: Annotated[
        ToolLengths | None,
        option(
            "Without a tool table: refuse G43 H and G41 D (table), or take lengths and radii as 0 "
            "with a warning (zero); by default zero, but table where a machine moves."
        ),
    ] = None
    unknown_codes: Annotated[
        UnknownCodes | None,
        option("M-codes that no dialect knows: an error (the default), or a warning; no effect."),
    ] = None
    default_feed: Annotated[
        float | None,
        Parameter(
            help="Feed before the first F word of the program, mm/min; by default a feed move "
            "without F is an error.",
            validator=validators.Number(gt=0),
        ),
    ] = None
    block_delete: Annotated[
        tuple[int, ...],
        Parameter(
            help="Switch of block delete that is on, 1 to 9: skip the lines that begin with / (1) "
            "or /2; may be given several times.",
            validator=validators.Number(gte=1, lte=9),
            negative="",
        ),
    ] = ()
    optional_stop: Annotated[bool, option("Stop at M1 as at M0.")] = False
    terminal: TerminalOptions = field(default_factory=TerminalOptions)

    def prepare(
        self, *inputs: str | None, to_standard_output: bool = False, further: str | None = None
    ) -> None:
        """Check the names of files, and begin to log.

        Args:
            *inputs: Files that are read, beside the machine file.
            to_standard_output: Whether the command prints results to standard output.
            further: A further output.

        Raises:
            UsageError: If two outputs are the same file, or an output is also an input.
        """
        inputs = (self.machine, self.height_map, *inputs)
        outputs = (*self._outputs, self.json, further, self.terminal.log)
        check_files(outputs, inputs, standard_output_taken=to_standard_output)
        self.terminal.open_log(*inputs)

    def run_options(self, **others: object) -> cnc.RunOptions:
        """Return the options of a run; ``others``: further fields of RunOptions."""
        picture, stl = others.pop("picture", None), others.pop("stl", None)
        return cnc.RunOptions(
            dialect=self.dialect,
            interpolator=self.interpolator,
            algorithm=self.algorithm,
            feed_override=self.feed_override,
            tool_lengths=self.tool_lengths,
            unknown_codes=self.unknown_codes or "error",
            height_map=self.height_map,
            default_feed=self.default_feed,
            block_delete=frozenset(self.block_delete),
            optional_stop=self.optional_stop,
            outputs=cnc.Outputs(*self._outputs, picture=picture, stl=stl),  # type: ignore[arg-type]
            **others,  # type: ignore[arg-type]
        )

    @property
    def _outputs(self) -> tuple[str | None, str | None, str | None, str | None]:
        return self.blocks, self.trace, self.pulses, self.lines

    @property
    def has_program_outputs(self) -> bool:
        """Whether a file is to be written that describes one program."""
        return any(self._outputs)

    @property
    def summary_file(self) -> TextIO:
        """The stream for the summary: standard error if an output uses standard output."""
        return sys.stderr if "-" in (*self._outputs, self.json) else sys.stdout


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """Options of a run on a board."""

    board: BoardOption = None
    port: Annotated[
        str | None,
        option(
            "Port of the board (/dev/ttyUSB0); for --board file, the .npz file to write.", DAILY
        ),
    ] = None
    check_on_board: Annotated[
        bool, option("Let the board read the program without moving (GRBL's $C).")
    ] = False
    from_line: Annotated[
        int | None,
        option("Begin at this source line: show the moves to it at a safe height, and ask.", DAILY),
    ] = None
    rapid_override: Annotated[
        int | None, option("Per cent of the traverse speeds on a GRBL board: 25, 50 or 100.")
    ] = None
    spindle_override: Annotated[
        float | None, option("Per cent of the spindle speeds on a GRBL board, 10 to 200.")
    ] = None
    plain: Annotated[
        bool,
        option("Print a line every ten seconds in place of the screen, as without a terminal."),
    ] = False
    yes: Annotated[
        bool,
        option("Do not ask; without a terminal, skip the pauses for the operator (M0, M6).", DAILY),
    ] = False
    home: Annotated[bool, option("Home the machine before the program, as cncrun home does.")] = (
        False
    )
    trust_position: Annotated[
        bool,
        option(
            "Confirm the position that the GRBL board reports, although the last run ended "
            "elsewhere; --yes does not confirm it."
        ),
    ] = False

    def control(self, feed_override: float) -> Control:
        """Return the operator control with the first overrides."""
        control = Control(feed_override)
        if self.rapid_override is not None:
            control.override_rapids(self.rapid_override)
        if self.spindle_override is not None:
            control.override_spindle(self.spindle_override)
        return control


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """Options that select what a check examines and reports."""

    jobs: Annotated[
        int | None,
        Parameter(
            help="Number of programs to check at once; by default one for each core.",
            validator=validators.Number(gte=1),
        ),
    ] = None
    select: Annotated[
        tuple[str, ...], option("Of the warnings and notes, report only these codes.")
    ] = ()
    ignore: Annotated[
        tuple[str, ...], option("Do not report warnings and notes of these codes.")
    ] = ()
    errors: Annotated[frozenset[str], Parameter(parse=False)] = frozenset()
    stock: Annotated[
        str | None,
        option(
            "The raw part, such as X0:100,Y0:60,Z-12:0 (mm, machine coordinates of the tool tip); "
            "the cut is simulated, and a G0, a shank or a holder in material is reported."
        ),
    ] = None
    stock_resolution: Annotated[
        float | None,
        Parameter(
            help="Width of a cell of the simulated stock, mm; by default 0.1, and more for a stock "
            "of more than 4 million cells.",
            validator=validators.Number(gt=0),
        ),
    ] = None
    stl: Annotated[str | None, output("Write the part that is cut from the stock to FILE.stl.")] = (
        None
    )
    portable: Annotated[
        tuple[str, ...],
        option("Dialects that must read the program in the same way, such as grbl,linuxcnc."),
    ] = ()
    scheduler: Annotated[
        str | None,
        option("Check on a Dask cluster: address of its scheduler, such as tcp://host:8786."),
    ] = None

    @property
    def selection(self) -> cnc.Selection:
        """The findings to report."""
        return cnc.Selection(
            frozenset(_split(self.select)), frozenset(_split(self.ignore)), self.errors
        )

    def run_options(self, common: CommonOptions, *, picture: str | None = None) -> cnc.RunOptions:
        """Return the options of a check."""
        return common.run_options(
            selection=self.selection,
            portable=tuple(_split(self.portable)),
            picture=picture,
            stl=self.stl,
            stock_resolution=self.stock_resolution,
        )


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FixOptions:
    """Options of a check that repairs programs."""

    fix: Annotated[
        bool, option("Repair the findings that have one right repair, and write the programs.")
    ] = False
    unsafe_fixes: Annotated[
        bool, option("With --fix or --diff: also repairs that change what a program does.")
    ] = False
    diff: Annotated[
        bool, option("Show the repairs and write nothing; exit code 1 if there are any.")
    ] = False

    @property
    def wanted(self) -> bool:
        """Whether repairs are made or shown.

        Raises:
            UsageError: ``--unsafe-fixes`` stands alone.
        """
        if self.unsafe_fixes and not (self.fix or self.diff):
            message, hint = "--unsafe-fixes says which repairs are made", "add --fix or --diff"
            raise UsageError(Diagnostic("usage", message, hint=hint))
        return self.fix or self.diff


def _split(listed: Sequence[str]) -> list[str]:
    """Return the items of lists that are separated by commas."""
    return [item for items in listed for item in items.split(",") if item]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ConvertOptions:
    """Options of convert: the control, and the file of the result."""

    to: Annotated[TargetName, option("The control to write the program for.")]
    file: Annotated[
        str | None,
        Parameter(name=["--output", "-o"], help="The file to write; by default it is printed."),
    ] = None
    in_place: Annotated[bool, option("Write the program to its own file.")] = False
    tolerance: Annotated[
        float,
        Parameter(
            help="Largest distance of curves that are written anew, mm.",
            validator=validators.Number(gte=1e-4, lte=1.0),
        ),
    ] = 0.01
    curves: Annotated[
        Curves,
        option("How short straight moves are written: as they are, as arcs, or as NURBS."),
    ] = "lines"

    def output(self, program: str) -> str:
        """Return the file of the result; ``-`` is standard output.

        Raises:
            UsageError: The options do not fit together.
        """
        if not self.in_place:
            return "-" if self.file is None else self.file.replace(HYPHEN, "-")
        if program == "-" or self.file is not None:
            message = "--in-place writes to the file of the program"
            raise UsageError(Diagnostic("usage", message, hint="leave it out, or name a file"))
        return program


def check_files(
    outputs: Sequence[str | None],
    inputs: Sequence[str | None],
    *,
    standard_output_taken: bool = False,
) -> None:
    """Check that no output overwrites an input or another output.

    Raises:
        UsageError: ``output-twice``, ``output-over-input``.
    """
    read = {os.path.realpath(name): name for name in inputs if name is not None and name != "-"}
    taken = {"-"} if standard_output_taken else set()
    for name in outputs:
        if name is None:
            continue
        file = name if name == "-" else os.path.realpath(name)
        if file in taken:
            target = "standard output" if name == "-" else name
            message, hint = f"two outputs go to {target}", "give each output a file of its own"
            raise UsageError(Diagnostic("output-twice", message, hint=hint))
        if file in read:
            message = f"an output would overwrite {read[file]}"
            raise UsageError(Diagnostic("output-over-input", message, hint="give it another name"))
        taken.add(file)


# Options of measurements.


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class MeasureOptions:
    """Options of all measurements."""

    yes: Annotated[bool, option("Write the machine file without a question.")] = False
    machine: MachineOption = None
    board: BoardOption = None
    port: PortOption = None
    terminal: TerminalOptions = TERMINAL


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SensorOptions(MeasureOptions):
    """Options of the accelerometer of a board."""

    unhomed: Annotated[bool, option("Move although the machine is not homed.")] = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GaugeOptions(MeasureOptions):
    """Options of measurements with a gauge, beside which the axes move slowly."""

    unhomed: Annotated[bool, option("Move although the machine is not homed.")] = False
    feed: Annotated[
        float | None, option("Speed, mm/min; by default the highest that stops within 0.2 s.")
    ] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ProbeOptions:
    """Options of the touch probe in place of a gauge."""

    probe: Annotated[bool, option("Measure with the touch probe in the spindle.")] = False
    reach: Annotated[float, option("With the probe: longest way to a face, mm.")] = 10.0
    contacts: Annotated[int, option("With the probe: contacts of a place.")] = 5
    contact_feed: Annotated[
        float, option("With the probe: speed of a first contact, mm/min; four times slower then.")
    ] = 100.0


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FaceOptions:
    """Options of faces at known distances, which the probe touches."""

    faces: Annotated[
        tuple[float, ...],
        Parameter(
            help="With the probe: distances of the faces from the first one, mm.",
            consume_multiple=True,
            negative="",
        ),
    ] = ()
    touch: Annotated[
        str, option("With the probe: the axis and the direction of the touches, such as X-.")
    ] = ""
    lift: Annotated[float, option("With the probe: way of Z over a face, mm.")] = 20.0
    blocks: Annotated[
        bool, option("With the probe: wait at each face until the row of blocks is changed.")
    ] = False

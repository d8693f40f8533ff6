"""The command line: options to :mod:`cnc.api`, a report to text and an exit code.

Whatever happens, the last thing on standard error is a message that says what, where and what to do, never a traceback. What takes long to
import is imported when it is needed: ``cncrun --help`` has to be quick.
"""

from __future__ import annotations

import gc
import glob
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from io import TextIOWrapper
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Literal, TextIO

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError, validators

from cnc import __version__
from cnc.control import Control
from cnc.errors import EXIT_REJECTED, EXIT_STOPPED, SEVERITIES, CncError, Diagnostic, Severity, UsageError
from cnc.keys import Keys
from cnc.report.changes import Baseline, told
from cnc.report.selection import Selection
from cnc.screen import Screen, tell_compiling

if TYPE_CHECKING:
    from cyclopts import Token

    from cnc.api import Outputs
    from cnc.machine.models import Machine
    from cnc.report.result import Report

SUFFIXES = (".nc", ".ngc", ".gcode", ".gc", ".cnc", ".tap", ".mpf")
"""What `check` takes for programs in a folder."""

EXIT_PIPE = 141
"""Whoever read our output went away: 128 + SIGPIPE, as a shell shows it for other tools."""

HYPHEN = "\0-"
"""Stands for a lone ``-`` while cyclopts parses, which would take it for an option; no argument can contain it."""

Dialect = Literal["auto", "linuxcnc", "grbl", "fanuc", "paper"]
Interpolator = Literal["reference-pulse", "sampled"]
CheckFormat = Literal["text", "json", "sarif", "junit", "github"]
Algorithm = Literal["enclosing-line", "half-step", "point-by-point", "kiritsis", "crossings"]

app = App(
    name="cncrun",
    help="Run G-code: read it, plan jerk-limited motion over its true curves, and send the pulses to a board.",
    version=__version__,
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)


def _option(text: str) -> Parameter:
    return Parameter(help=text, negative="")


def _output(text: str) -> Parameter:
    """An option that takes a file, or ``-``."""
    return Parameter(help=text, converter=_file_or_hyphen)


def _file_or_hyphen(_: object, tokens: Sequence[Token]) -> str:
    return tokens[0].value.replace(HYPHEN, "-")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of run and check alike."""

    machine: Annotated[str | None, _option("Machine file (TOML), or the name of a shipped one such as paper-nurbs.")] = None
    dialect: Annotated[Dialect | None, _option("How to read the program; the machine file's choice if left out.")] = None
    interpolator: Annotated[
        Interpolator, _option("reference-pulse: grid moves alone. sampled: also positions at the machine's period.")
    ] = "reference-pulse"
    algorithm: Annotated[
        Algorithm | None, _option("How grid moves are made; if left out: half steps on lines and arcs, enclosing lines on other curves.")
    ] = None
    feed_override: Annotated[float, _option("Per cent of the programmed feeds, 1 to 200; traverses are not scaled.")] = 100.0
    blocks: Annotated[str | None, _output("Write the canonical blocks to FILE.jsonl (- is standard output, here and below).")] = None
    trace: Annotated[str | None, _output("Write position, feed, acceleration and jerk a period to FILE.npz or FILE.csv.")] = None
    pulses: Annotated[str | None, _output("Write the grid moves to FILE.npz, or to FILE.vcd for a logic analyser.")] = None
    lines: Annotated[str | None, _output("Write the program as lines for a GRBL board, by our plan, to FILE.nc or FILE.gcode.")] = None
    json: Annotated[str | None, _output("Write the summary to FILE.json.")] = None
    quiet: Annotated[bool, _option("Say nothing but errors.")] = False
    verbose: Annotated[bool, _option("Say more: each axis's dynamics, computing times, details of an internal error.")] = False

    def check_outputs(self, *inputs: str | None, printing: bool = False, picture: str | None = None) -> None:
        """UsageError if two outputs are the same file (``printing``: standard output), or one is the machine file or one of ``inputs``."""
        read = {os.path.realpath(name): name for name in (self.machine, *inputs) if name is not None and name != "-"}
        taken = {"-"} if printing else set()
        for name in (self.blocks, self.trace, self.pulses, self.lines, self.json, picture):
            if name is None:
                continue
            file = name if name == "-" else os.path.realpath(name)
            if file in taken:
                what = "standard output" if name == "-" else name
                raise UsageError(Diagnostic("output-twice", f"two outputs go to {what}", hint="give each output a file of its own"))
            if file in read:
                raise UsageError(Diagnostic("output-over-input", f"an output would overwrite {read[file]}", hint="give it another name"))
            taken.add(file)

    def outputs(self) -> Outputs:
        """The files to write along the way."""
        from cnc.api import Outputs

        return Outputs(blocks=self.blocks, trace=self.trace, pulses=self.pulses, lines=self.lines)

    @property
    def summary_file(self) -> TextIO:
        """Where the summary for people goes: standard error if an output has taken standard output."""
        return sys.stderr if "-" in (self.blocks, self.trace, self.pulses, self.lines, self.json) else sys.stdout


_COMMON = Common()


@app.default
def run(
    program: Annotated[str, _output("The program (- is standard input).")],
    /,
    *,
    board: Annotated[
        str | None, _option("loopback, file, grbl, grbl-sim, or an installed driver; the machine file's board if left out.")
    ] = None,
    port: Annotated[str | None, _option("Where the board is (/dev/ttyUSB0); for --board file, the .npz file to write.")] = None,
    dry_run: Annotated[bool, _option("Only check, as `cncrun check` does.")] = False,
    check_on_board: Annotated[bool, _option("Let the board read the program without moving (a GRBL board's $C).")] = False,
    from_line: Annotated[int | None, _option("Begin at this source line: says how it gets there at a safe height, and asks.")] = None,
    yes: Annotated[bool, _option("Ask nothing; where there is no terminal, do not pause for the operator (M0, M6).")] = False,
    common: Common = _COMMON,
) -> int:
    """Run a program."""
    if dry_run:
        return check(program, common=common)
    api = _library()
    control = Control(common.feed_override)
    common.check_outputs(program, port)
    with Screen(control, quiet=common.quiet) as screen, Keys(control) as keys:
        machine = api.load_machine(common.machine)
        report = api.run(
            program,
            machine,
            board=board,
            port=port,
            dialect=common.dialect,
            interpolator=common.interpolator,
            algorithm=common.algorithm,
            outputs=common.outputs(),
            watch=replace(screen.watch(), on_beginning=lambda story: keys.agreed(story, yes=yes)),
            control=control,
            check_on_board=check_on_board,
            pauses="wait" if keys.available else "skip" if yes else "refuse",
            from_line=from_line,
        )
    if common.json is not None:
        _write_json(common.json, report)
    _show(report, common, common.summary_file)
    return _end([report], quiet=common.quiet)


@app.command
def check(
    *programs: Annotated[str, Parameter(help="Programs, folders of programs, and patterns such as 'parts/**/*.nc'.")],
    format: Annotated[CheckFormat, _option("What to print: a summary for people, JSON, or findings as other tools read them.")] = "text",
    jobs: Annotated[
        int | None, Parameter(help="How many programs to check at once; one a core if left out.", validator=validators.Number(gte=1))
    ] = None,
    select: Annotated[tuple[str, ...], _option("Of the warnings and notes show those of these codes alone.")] = (),
    ignore: Annotated[tuple[str, ...], _option("Don't show warnings and notes of these codes.")] = (),
    fail_on: Annotated[Severity, _option("The least severe finding that makes the exit code 1.")] = "error",
    stock: Annotated[str | None, _option("The raw part, such as X0:100,Y0:60,Z-12:0 (mm, machine coordinates): no G0 into it.")] = None,
    portable: Annotated[tuple[str, ...], _option("Dialects that have to read the program in the same way, such as grbl,linuxcnc.")] = (),
    scheduler: Annotated[str | None, _option("Check on a Dask cluster: its scheduler's address, such as tcp://host:8786.")] = None,
    baseline: Annotated[
        str | None, _option("A summary that --json wrote before: what changed since, and new findings alone decide the exit code.")
    ] = None,
    common: Common = _COMMON,
) -> int:
    """Verify programs without a board: language, travel, the limits of the plan, the pulses."""
    names = [name.replace(HYPHEN, "-") for name in programs]
    common.check_outputs(*names, baseline, printing=format != "text" and (format, common.json) != ("json", "-"))
    files = find_programs(names)
    listed = len(files) != 1 or names != files
    shown = common.summary_file if format == "text" else sys.stderr
    before = None if baseline is None else Baseline(baseline)
    look = Look(stock, Selection(frozenset(_codes(select)), frozenset(_codes(ignore))), tuple(_codes(portable)), jobs, scheduler)
    reports = _check_listed(files, common, look, shown) if listed or scheduler else [_check_one(files[0], common, look)]
    if before is not None:
        for report in reports:
            report.changes = before.changes(report)
    for name in {common.json, "-" if format == "json" else None}:
        if name is not None:
            _write_json(name, reports if listed else reports[0])
    if format != "text" and format != "json":
        from cnc.report.formats import write_format

        write_format(format, reports)
    if not listed:
        _show(reports[0], common, shown)
    if before is not None and not common.quiet:
        print(*told(reports, before.missing(reports)), sep="\n", file=shown)
    return _end(reports, quiet=common.quiet, fail_on=fail_on)


@dataclass(frozen=True)
class Look:
    """What `check` looks for, and how."""

    stock: str | None = None
    selection: Selection = field(default_factory=Selection)
    portable: tuple[str, ...] = ()
    jobs: int | None = None
    scheduler: str | None = None

    def machine(self, name: str | None) -> Machine:
        """The machine of a file, with the raw part on it."""
        from cnc.machine.load import load_machine
        from cnc.machine.stock import with_stock

        machine = load_machine(name)
        return machine if self.stock is None else with_stock(machine, self.stock)


def _codes(listed: Sequence[str]) -> list[str]:
    """What was given one by one or with commas between."""
    return [code for each in listed for code in each.split(",") if code]


def _check_one(file: str, common: Common, look: Look, picture: str | None = None) -> Report:
    """A program alone, in this process."""
    api = _library()
    machine = look.machine(common.machine)
    control = Control(common.feed_override)
    with Screen(control, quiet=common.quiet) as screen:
        report: Report = api.check(
            file,
            machine,
            dialect=common.dialect,
            interpolator=common.interpolator,
            algorithm=common.algorithm,
            outputs=replace(common.outputs(), picture=picture),
            watch=screen.watch(),
            control=control,
            selection=look.selection,
            portable=look.portable,
        )
    return report


def _check_listed(files: Sequence[str], common: Common, look: Look, shown: TextIO) -> list[Report]:
    """Programs in their order, in processes of their own; a line for each as soon as those before it have theirs."""
    from cnc.batch.pool import check_many
    from cnc.report.summary import one_line

    if any((common.blocks, common.trace, common.pulses, common.lines)):
        raise UsageError(
            Diagnostic(
                "one-program-only", "--blocks, --trace, --pulses and --lines take one program", hint="check that program alone to get them"
            )
        )
    if look.scheduler is not None and look.jobs is not None:
        raise UsageError(Diagnostic("jobs-and-scheduler", "--jobs is for this computer, --scheduler for others", hint="give one of them"))
    reports: list[Report] = []
    control = Control(common.feed_override)
    with Screen(control, quiet=common.quiet) as screen:
        found = check_many(
            files,
            look.machine(common.machine),
            dialect=common.dialect,
            sampled=common.interpolator == "sampled",
            algorithm=common.algorithm,
            feed_override=control.feed_override,
            selection=look.selection,
            portable=look.portable,
            jobs=look.jobs,
            scheduler=look.scheduler,
            on_done=lambda done: screen.count(done, len(files)),
            on_compiling=None if common.quiet else tell_compiling,
        )
        for report in found:
            reports.append(report)
            for warning in report.warnings:
                screen.warn(warning)
            if not common.quiet:
                print(one_line(report), file=shown, flush=True)
    return reports


@app.command
def diff(
    first: Annotated[str, _output("A program (- is standard input).")],
    second: Annotated[str, _output("The one to compare with it.")],
    /,
    *,
    machine: Annotated[str | None, _option("Machine file (TOML), or the name of a shipped one.")] = None,
    dialect: Annotated[Dialect | None, _option("How to read the programs; the machine file's choice if left out.")] = None,
    json: Annotated[str | None, _output("Write what is found to FILE.json (- is standard output).")] = None,
    quiet: Annotated[bool, _option("Say nothing but errors.")] = False,
) -> int:
    """Compare the motion of two programs, not their text: how far apart, where, how long."""
    if first == second == "-":
        raise UsageError(Diagnostic("usage", "standard input holds one program", hint="name a file for the other one"))
    _library()
    from cnc.compare.programs import compare
    from cnc.machine.load import load_machine
    from cnc.report.outputs import write_object

    Common(machine=machine, json=json).check_outputs(first, second)
    with Screen(Control(), quiet=quiet) as screen:
        found = compare(first, second, load_machine(machine), dialect, screen.watch())
    if all(report.ok and report.stopped_at_line is None for report in found.reports):
        if json is not None:
            write_object(json, found.as_json())
        if not quiet:
            print(*found.lines(), sep="\n", file=sys.stderr if json == "-" else sys.stdout)
    return _end(found.reports, quiet=quiet)


@app.command
def view(
    program: Annotated[str, _output("The program (- is standard input).")],
    /,
    *,
    output: Annotated[str, Parameter(name=["--output", "-o"], help="The picture: a page to turn and play (.html), or a .png or .svg.")],
    stock: Annotated[str | None, _option("The raw part to draw, such as X0:100,Y0:60,Z-12:0 (mm, machine coordinates).")] = None,
    common: Common = _COMMON,
) -> int:
    """Draw a program: its path in space, its feed, acceleration and jerk over time, its text beside them."""
    common.check_outputs(program, picture=output)
    report = _check_one(program, common, Look(stock), output)
    if common.json is not None:
        _write_json(common.json, report)
    _show(report, common, common.summary_file)
    if report.ok and report.stopped_at_line is None and not common.quiet:
        print(f"picture      {output}", file=common.summary_file)
    return _end([report], quiet=common.quiet)


@app.command
def boards(
    *ports: Annotated[str, Parameter(help="Ports to look at, pyserial URLs too; all serial ports of this computer if left out.")],
    baud: Annotated[int, _option("Bits a second of the links.")] = 115200,
) -> int:
    """List the serial ports and what answers on each: firmware, settings, and the machine file that they make (redirect it into a file).

    Opening a port resets most boards.
    """
    from cnc.boards import look, page

    found = look(ports, baud)
    for each in found:
        print(*page(each, baud), sep="\n", flush=True)
    if not found:
        print("# this computer has no serial port; is the board plugged in and switched on?")
    return next((_fail(each.fault) for each in found if ports and each.fault is not None), 0)


@app.command
def papers(
    folder: Annotated[Path, Parameter(help="Where the page and its figures go.")] = Path("papers"),
    /,
    *,
    quiet: Annotated[bool, _option("Do not print the tables.")] = False,
) -> int:
    """Run the experiments of the papers that the interpolators come from: tables and figures, published beside ours."""
    from cnc.papers import page
    from cnc.papers.contents import sections
    from cnc.screen import tell_compiling
    from cnc.warm import ensure_compiled

    page.prepared(folder)
    ensure_compiled(None if quiet else tell_compiling)
    done = []
    for section in sections():
        if not quiet:
            print(page.markdown(section), end="\n\n", flush=True)
        done.append(section)
    written = page.write(done, folder)
    if not quiet:
        print(written)
    return 0


def find_programs(names: Sequence[str]) -> list[str]:
    """Files in the order given: a folder stands for the programs anywhere in it, a pattern for what it matches, each sorted by name.

    UsageError ``no-program`` where nothing is named, or a folder or pattern has no program.
    """
    if not names:
        raise UsageError(Diagnostic("no-program", "no program is named", hint="cncrun check PROGRAM..."))
    found: list[str] = []
    for name in names:
        path = Path(name)
        if path.is_dir():
            matches = sorted(str(file) for file in path.rglob("*") if file.suffix.lower() in SUFFIXES and file.is_file())
            where = f"the folder {name} has no programs ({' '.join('*' + suffix for suffix in SUFFIXES)})"
        elif not path.exists() and glob.has_magic(name):
            matches = sorted(file for file in glob.glob(name, recursive=True) if os.path.isfile(file))
            where = f"no file matches {name}"
        else:
            matches, where = [name], ""
        if not matches:
            raise UsageError(Diagnostic("no-program", where, hint="check the name and the folder"))
        found += matches
    return list(dict.fromkeys(found))


def _library() -> ModuleType:
    """:mod:`cnc.api`. All that it brings along lives as long as the process: the garbage collector need not look at it time and again."""
    from cnc import api

    gc.freeze()
    return api


def main(arguments: Sequence[str] | None = None) -> None:
    """The program ``cncrun``: carry out and exit. Codes: 0 well, 1 program, 2 usage, 3 board, 130 stopped; 1 for an internal error, too."""
    # A file's name need not be text; it must not end the run, as little as its contents.
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.exit(exit_code(sys.argv[1:] if arguments is None else arguments))


def exit_code(arguments: Sequence[str]) -> int:
    """Carry out a command line; whatever is raised becomes a message and a code."""
    try:
        result = app(
            [HYPHEN if each == "-" else each for each in arguments], exit_on_error=False, print_error=False, result_action="return_value"
        )
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except CycloptsError as error:
        return _fail(UsageError(Diagnostic("usage", _usage(error), hint="cncrun --help lists the commands and options")))
    except CncError as error:
        return _fail(error)
    except KeyboardInterrupt as stop:
        print(str(stop) or "stopped by the operator; nothing has moved", file=sys.stderr)
        return EXIT_STOPPED
    except BrokenPipeError:
        # Python flushes standard output once more at its end: give it something to flush to.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except Exception as error:
        return _internal_error(error, "--verbose" in arguments)


def _usage(error: CycloptsError) -> str:
    """What is wrong with the command line, in one line and in our words where cyclopts speaks of its own."""
    if isinstance(error, UnusedCliTokensError):
        return (
            f"cncrun runs one program, {' '.join(error.unused_tokens or [])} is too much; several can be checked: cncrun check PROGRAM..."
        )
    return " ".join(str(error).split())


def _fail(error: CncError) -> int:
    sys.stdout.flush()
    print(error.diagnostic.render(), file=sys.stderr)
    return error.exit_code


def _internal_error(error: Exception, verbose: bool) -> int:
    """A fault of ours: said as such, with a way to learn more."""
    if verbose:
        import traceback

        traceback.print_exception(error)
    kind = type(error).__name__
    hint = "please report the program, the machine file and this message; --verbose shows where it happened"
    print(Diagnostic("internal-error", f"cncrun failed: {kind}: {error}", hint=hint).render(), file=sys.stderr)
    return EXIT_REJECTED


def _end(reports: Sequence[Report], *, quiet: bool, fail_on: Severity = "error") -> int:
    """Faults of all reports on standard error, and lesser findings that count for as much; the exit code of the worst."""
    counting = SEVERITIES[: SEVERITIES.index(fail_on) + 1]
    sys.stdout.flush()
    for report in reports:
        if report.hidden_warnings and not quiet:
            print(f"{report.program}: {report.hidden_warnings} more warnings are not shown", file=sys.stderr)
        if report.hidden_faults:
            print(f"{report.program}: {report.hidden_faults} more places outside the travel are not shown", file=sys.stderr)
        for finding in report.counting:
            if finding.severity in counting:
                print(finding.render(), file=sys.stderr)
    stopped = next((report for report in reports if report.stopped_at_line is not None), None)
    code = max((report.exit_code for report in reports), default=0)
    if stopped is not None and code == 0:
        print(_where_stopped(stopped), file=sys.stderr)
        return EXIT_STOPPED
    return code or int(any(finding.severity in counting for report in reports for finding in report.counting)) * EXIT_REJECTED


def _where_stopped(report: Report) -> str:
    from cnc.report.summary import position

    if report.board is None or not report.stopped_at_line:
        return "stopped by the operator; nothing has moved"
    place = " ".join(f"{axis.upper()}{position(value)}" for axis, value in report.end_position.items())
    return f"stopped by the operator at line {report.stopped_at_line}; the board has come to rest at {place}"


def _write_json(name: str, summary: Report | Sequence[Report]) -> None:
    from cnc.report.outputs import write_json

    write_json(name, summary)


def _show(report: Report, common: Common, stream: TextIO) -> None:
    """The summary; a program that never moved has none."""
    if common.quiet or report.faults or report.stopped_at_line is not None:
        return
    from rich.console import Console

    from cnc.report.summary import print_summary

    console = Console(file=stream, highlight=False, width=None if stream.isatty() else 120)
    print_summary(report, console, verbose=common.verbose)


if __name__ == "__main__":
    main()

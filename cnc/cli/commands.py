"""The commands of the program ``cncrun``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from cyclopts import App, CycloptsError, Parameter
from cyclopts.argument import ArgumentCollection

import cnc
from cnc.cli import work
from cnc.cli.keyboard import Keyboard
from cnc.cli.measure_commands import backlash, limits, pitch, ringing, square
from cnc.cli.messages import EXIT_PIPE, close_log, fail, internal_error, usage
from cnc.cli.operate_commands import (
    boards,
    height_map,
    home,
    jog,
    mdi,
    serve,
    settings,
    unlock,
    zero,
)
from cnc.cli.options import (
    DAILY,
    HYPHEN,
    OTHERS,
    TERMINAL,
    BoardOptions,
    CheckFormat,
    CheckOptions,
    CommonOptions,
    ConvertOptions,
    FixOptions,
    MachineOption,
    TerminalOptions,
    check_files,
    option,
    output,
)
from cnc.cli.progress import ProgressDisplay
from cnc.cli.signals import NO_SPACE, OperatorSignals, report_hang_up
from cnc.compiled.code_cache import cache_folder
from cnc.model.choices import DialectName, Pauses, TextStyle
from cnc.model.diagnostics import (
    EXIT_STOPPED,
    CncError,
    Diagnostic,
    Severity,
    UsageError,
    printable,
    shown_name,
    write_error,
)
from cnc.model.operator_control import HomingStopped
from cnc.version import __version__

# The application of cyclopts, with a quicker ``--help``.


class Application(App):
    """An application whose options have their texts in ``Parameter(help=...)``."""

    collections: ClassVar[dict[int, ArgumentCollection] | None] = None
    """Options of each command (its ``id``) while help is printed, else None.

    cyclopts assembles them three times to print help: to parse, for the usage, and for the text.
    They are not shared by other command lines, because parsing fills them with values.
    """

    def help_print(self, tokens: Any = None, *, console: Any = None) -> None:
        """Print the help of a command; that of the program has its commands by task."""
        if self is app and not tokens:
            print(program_help())
        else:
            super().help_print(tokens, console=console)

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
        collections = self.collections
        if collections is None or default_parameter is not None:
            return super().assemble_argument_collection(default_parameter=default_parameter)
        if id(self) not in collections:
            collections[id(self)] = super().assemble_argument_collection()
        return collections[id(self)]


USAGE = "Usage: cncrun [run] PROGRAM [OPTIONS]\n       cncrun COMMAND [ARGUMENTS] [OPTIONS]"
TASKS = {
    "Look": ("check", "view", "diff", "config"),
    "Run": ("run", "serve", "boards"),
    "Set up": (
        *("home", "jog", "zero", "mdi", "unlock", "tools", "height-map"),
        *("measure", "settings"),
    ),
    "Write": ("format", "convert", "lsp"),
    "Develop": ("schema", "papers", "warm"),
}
"""The commands, by what people do with them, in the order of the help."""


def program_help() -> str:
    """Return the help of the program: one line for each command."""
    lines = [
        USAGE,
        "",
        "Run G-code: read it, plan jerk-limited motion over its true curves,",
        "and send the pulses to a board.",
        "",
    ]
    for task, names in TASKS.items():
        for name in names:
            lines.append(f"{task if name == names[0] else '':9}{name:12}{summary_of(name)}")
    return "\n".join([
        *lines,
        "",
        "--help (-h) and --version stand alone.",
        "Options of a run: cncrun run --help. Of a command: cncrun COMMAND --help.",
    ])  # fmt: skip


def summary_of(command: str) -> str:
    """Return what a command does, in one line."""
    return app[command].help.split("\n")[0]


app = Application(
    name="cncrun",
    usage=USAGE,
    help_format="plaintext",  # Markdown would double the time of --help.
    group_parameters=OTHERS,
    version=__version__,
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)

ProgramOption = Annotated[str, output("The program (- is standard input).")]
app.command(settings)
app.command(boards)
app.command(home)
app.command(jog)
app.command(unlock)
app.command(zero)
app.command(mdi)
app.command(height_map)
measure = Application(
    name="measure",
    help="Measure backlash, screws, squareness, limits, ringing.",
    help_format="plaintext",
)
measure.command(backlash)
measure.command(pitch)
measure.command(square)
measure.command(limits)
measure.command(ringing)
app.command(measure)
app.command(serve)
COMMON, BOARD, CHECK, FIX = CommonOptions(), BoardOptions(), CheckOptions(), FixOptions()


@app.command
def run(
    program: ProgramOption,
    /,
    *,
    dry_run: Annotated[bool, option("Only check, as cncrun check does.", DAILY)] = False,
    on_board: BoardOptions = BOARD,
    common: CommonOptions = COMMON,
) -> int:
    """Run a program on a board; run may be left out."""
    if dry_run:
        return check(program, common=common)
    common.prepare(program, on_board.port)
    chosen = work.projects.options_of(program, common)
    control = on_board.control(common.feed_override)
    display = ProgressDisplay(control, quiet=common.terminal.quiet, plain=on_board.plain)
    with display, Keyboard(control, report_hang_up) as keys:
        if not keys.available:
            display.without_keys()
        pauses: Pauses = "wait" if keys.available else "skip" if on_board.yes else "refuse"
        report = cnc.run(
            program,
            chosen.machine,
            chosen.common.run_options(
                selection=chosen.check.selection,
                pauses=pauses,
                from_line=on_board.from_line,
                home=on_board.home,
                trust_position=on_board.trust_position,
                check_on_board=on_board.check_on_board,
            ),
            board=on_board.board,
            port=on_board.port,
            callbacks=replace(
                display.callbacks(),
                on_beginning=lambda steps: keys.confirm(steps, yes=on_board.yes),
            ),
            control=control,
        )
    return work.checking.finish(report, common)


@app.command
def check(
    *programs: Annotated[
        str, Parameter(help="Programs, folders of programs, and patterns such as 'parts/**/*.nc'.")
    ],
    format: Annotated[
        CheckFormat,
        option("Output: a summary for people, JSON, or findings in the format of other tools."),
    ] = "text",
    fail_on: Annotated[
        Severity, option("The least severe finding that makes the exit code 1.")
    ] = "error",
    baseline: Annotated[
        str | None,
        option(
            "A summary that --json wrote earlier: report the changes; only new findings decide the "
            "exit code."
        ),
    ] = None,
    fixes: FixOptions = FIX,
    options: CheckOptions = CHECK,
    common: CommonOptions = COMMON,
) -> int:
    """Verify programs without a board; nothing moves.

    A check covers the language, the travel, the limits of the plan, and the pulses.
    """
    names = [name.replace(HYPHEN, "-") for name in programs]
    prints_results = format != "text" and (format, common.json) != ("json", "-")
    common.prepare(*names, baseline, to_standard_output=prints_results, further=options.stl)
    if fixes.wanted:
        stream = common.summary_file if format == "text" else sys.stderr
        repairs = work.rewriting.repair_programs(names, common, options, fixes, stream)
        if fixes.diff:
            return repairs
    return work.checking.check_programs(names, common, options, format, baseline, fail_on)


@app.command
def diff(
    first: ProgramOption,
    second: Annotated[str, output("The program to compare with it.")],
    /,
    *,
    machine: MachineOption = None,
    dialect: Annotated[
        DialectName | None,
        option("How to read the programs; by default as the machine file specifies."),
    ] = None,
    json: Annotated[
        str | None, output("Write the result to FILE.json (- is standard output).")
    ] = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Compare the motion of two programs.

    The result has the largest distance, its place, and both durations.
    """
    if first == second == "-":
        message, hint = "standard input holds one program", "name a file for the other program"
        raise UsageError(Diagnostic("usage", message, hint=hint))
    check_files((json, terminal.log), (machine, first, second))
    terminal.open_log(machine, first, second)
    return work.rewriting.compare_programs(
        (first, second), machine, dialect, json, quiet=terminal.quiet
    )


@app.command
def view(
    program: ProgramOption,
    /,
    *,
    output: Annotated[
        str,
        Parameter(
            name=["--output", "-o"],
            help="The picture: an interactive page (.html), or a .png or .svg.",
        ),
    ],
    stock: Annotated[
        str | None,
        option("The raw part to draw, such as X0:100,Y0:60,Z-12:0 (mm, machine coordinates)."),
    ] = None,
    common: CommonOptions = COMMON,
) -> int:
    """Draw a program: its path, and its motion over time.

    The motion is feed, acceleration and jerk. A page has the text of the program, too.
    """
    common.prepare(program, further=output)
    report = work.checking.check_one(program, common, CheckOptions(stock=stock), output)
    return work.checking.finish(report, common, output)


@app.command
def papers(
    folder: Annotated[Path, Parameter(help="Folder for the page and its figures.")] = Path(
        "papers"
    ),
    /,
    *,
    quiet: Annotated[bool, option("Do not print the tables.")] = False,
) -> int:
    """Repeat the experiments of the papers: tables and figures.

    These are the papers behind the interpolators.
    """
    from cnc.papers import contents, page

    page.prepared(folder)
    work.checking.compile_kernels(quiet=quiet)
    done = []
    for section in contents.sections():
        if not quiet:
            print(page.markdown(section), end="\n\n", flush=True)
        done.append(section)
    missing = page.drawing_missing()
    written = page.write(done, folder, draws=missing is None)
    if missing is not None:
        print(f"warning: {missing.render()}", file=sys.stderr)
    if not quiet:
        print(shown_name(str(written)))
    return 0


@app.command
def tools(
    program: Annotated[str, output("The program (- is standard input).")],
    /,
    *,
    file: Annotated[
        str | None,
        Parameter(name=["--output", "-o"], help="The file to write; by default it is printed."),
    ] = None,
) -> int:
    """Write a skeleton of the tool table of a program.

    The tools come from T, H and D words and from the comments of CAM systems. Measure each tool,
    add its length, and name the file in the machine file: tool_table under [program].
    """
    check_files((file,), (program,))
    work.rewriting.write_tool_table(program, file)
    return 0


@app.command(name="format")
def format_programs(
    *programs: Annotated[
        str, Parameter(help="Programs, folders of programs, and patterns such as 'parts/**/*.nc'.")
    ],
    check: Annotated[
        bool, option("Write nothing; name the programs that have another form, with exit code 1.")
    ] = False,
    in_place: Annotated[bool, option("Write each program to its file.")] = False,
    style: Annotated[
        TextStyle | None,
        option("readable or compact; by default the style of the machine file."),
    ] = None,
    machine: MachineOption = None,
    dialect: Annotated[
        DialectName | None,
        option("How to read the programs; by default as the machine file specifies."),
    ] = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Write programs in one form: blanks, capitals, words.

    Comments stay. Words are put in order. The program is read in both forms: its blocks are the
    same to the bit.
    """
    terminal.open_log(machine, *programs)
    names = [name.replace(HYPHEN, "-") for name in programs]
    return work.rewriting.format_programs(
        names, machine, dialect, style, check=check, in_place=in_place, quiet=terminal.quiet
    )


@app.command
def config(program: ProgramOption, /) -> int:
    """Show what holds for a program, and why.

    The project file is cncrun.toml, or [tool.cncrun] in pyproject.toml, found upwards.
    """
    print(*work.projects.described(program), sep="\n")
    return 0


@app.command
def lsp(
    *,
    machine: MachineOption = None,
    dialect: Annotated[
        DialectName | None,
        option("How to read the programs; by default as the project file specifies."),
    ] = None,
    stdio: Annotated[bool, option("Ignored: the server uses standard input and output.")] = True,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Serve an editor: findings, meanings, repairs.

    It speaks the Language Server Protocol on standard input and output. It needs the extra:
    pip install 'cncrun[lsp]'. Options in cncrun.toml hold for the programs of its folder.
    """
    terminal.open_log(machine)
    try:
        serve_editor = work.language_server.serve
    except ImportError as error:
        message = f"the language server needs {error.name}, which is not installed"
        hint = "pip install 'cncrun[lsp]'"
        raise UsageError(Diagnostic("lsp-missing", message, hint=hint)) from error
    serve_editor(CommonOptions(machine=machine, dialect=dialect))
    return 0


@app.command
def convert(
    program: ProgramOption,
    /,
    *,
    options: ConvertOptions,
    machine: MachineOption = None,
    dialect: Annotated[
        DialectName | None,
        option("How to read the program; by default as the machine file specifies."),
    ] = None,
    json: Annotated[
        str | None, output("Write the report to FILE.json (- is standard output).")
    ] = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Write the program of one control for another one.

    The result is read back, and its motion is compared with that of the program. The report on
    standard error has what was kept, expanded and assumed, and the largest distance.
    """
    file = options.output(program)
    check_files((None if options.in_place else file, json, terminal.log), (machine, program))
    terminal.open_log(machine, program)
    return work.rewriting.convert_program(
        program, file, options, machine, dialect, json, quiet=terminal.quiet
    )


@app.command
def warm(*, quiet: Annotated[bool, option("Print nothing but errors.")] = False) -> int:
    """Compile all kernels now, for an image or a CI job.

    The command prints the folder of the compiled code.
    """
    work.checking.compile_kernels(quiet=quiet)
    if not quiet:
        print(f"compiled code  {printable(str(cache_folder()))}")
    return 0


@app.command
def schema(
    document: Annotated[
        Literal["machine", "project", "summary", "checkpoint", "height-map"],
        Parameter(
            help="machine: the machine file. project: the file cncrun.toml. "
            "summary: the summary that --json writes. "
            "checkpoint: the file that a run keeps beside its program. "
            "height-map: the heights of a surface."
        ),
    ],
    /,
) -> int:
    """Print the JSON Schema of a file format."""
    from cnc.cli.schemas import SCHEMAS  # without the library, which takes longer

    print(json.dumps(SCHEMAS[document](), indent=2, ensure_ascii=False))
    return 0


def exit_code(arguments: Sequence[str]) -> int:
    """Carry out a command line; return its exit code. Errors are printed as messages."""
    try:
        return _carry_out(arguments)
    except BrokenPipeError:
        # Python flushes standard output again at its exit, which must not fail.
        _drop_output()
        return EXIT_PIPE
    except OSError as error:
        if error.errno not in NO_SPACE or error.filename is not None:
            return internal_error(error, not {"--verbose", "-v"}.isdisjoint(arguments))
        _drop_output()
        return fail(write_error("-", error))
    except Exception as error:
        return internal_error(error, not {"--verbose", "-v"}.isdisjoint(arguments))
    finally:
        close_log()


def _drop_output() -> None:
    """Let standard output take and drop everything."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _carry_out(arguments: Sequence[str]) -> int:
    OperatorSignals.moved = False
    if not arguments:
        _carry_out(["--help"])
    asks = not {"--help", "-h"}.isdisjoint(arguments)
    Application.collections = {} if asks else None
    if not arguments or arguments[0] not in set(app):
        arguments = ["run", *arguments]
    try:
        result = app(
            [HYPHEN if word == "-" else word for word in arguments],
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except CycloptsError as error:
        hint = "cncrun --help lists the commands, cncrun COMMAND --help the options"
        return fail(UsageError(Diagnostic("usage", usage(error), hint=hint)))
    except CncError as error:
        return fail(error)
    except HomingStopped as stop:
        print(stop, file=sys.stderr)
        return EXIT_STOPPED
    except KeyboardInterrupt as stop:
        nothing = "" if OperatorSignals.moved else "; nothing has moved"
        print(str(stop) or f"stopped by the operator{nothing}", file=sys.stderr)
        return EXIT_STOPPED

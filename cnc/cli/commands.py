"""The commands, and the program ``cncrun``."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter, validators

from cnc import __version__
from cnc.checks.baseline import Baseline, change_lines
from cnc.checks.selection import Selection
from cnc.cli.checking import Look, check_listed, check_one, codes, find_programs
from cnc.cli.exit_status import EXIT_PIPE, end, fail, internal_error, show, usage, write_summary
from cnc.cli.keyboard import Keys
from cnc.cli.options import COMMON, HYPHEN, CheckFormat, Common, Dialect, library, option, output
from cnc.cli.progress import Screen
from cnc.model.diagnostics import EXIT_STOPPED, CncError, Diagnostic, Severity, UsageError
from cnc.model.operator_control import Control, HomingStopped

app = App(
    name="cncrun",
    help="Run G-code: read it, plan jerk-limited motion over its true curves, and send the pulses to a board.",
    version=__version__,
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)


@app.default
def run(
    program: Annotated[str, output("The program (- is standard input).")],
    /,
    *,
    board: Annotated[
        str | None,
        option(
            "loopback, stepper, grbl, grbl-sim, file, or an installed driver; the machine file's board if left out."
        ),
    ] = None,
    port: Annotated[
        str | None,
        option("Where the board is (/dev/ttyUSB0); for --board file, the .npz file to write."),
    ] = None,
    dry_run: Annotated[bool, option("Only check, as `cncrun check` does.")] = False,
    check_on_board: Annotated[
        bool, option("Let the board read the program without moving (a GRBL board's $C).")
    ] = False,
    from_line: Annotated[
        int | None,
        option("Begin at this source line: says how it gets there at a safe height, and asks."),
    ] = None,
    yes: Annotated[
        bool,
        option("Ask nothing; where there is no terminal, do not pause for the operator (M0, M6)."),
    ] = False,
    home: Annotated[
        bool, option("Let the axes find their limit switches first, as `cncrun home` does.")
    ] = False,
    trust_position: Annotated[
        bool,
        option(
            "The position that the GRBL board reports is right, though the last run ended elsewhere; --yes does not say so."
        ),
    ] = False,
    common: Common = COMMON,
) -> int:
    """Run a program."""
    if dry_run:
        return check(program, common=common)
    api = library()
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
            home=home,
            trust_position=trust_position,
        )
    if common.json is not None:
        write_summary(common.json, report)
    show(report, common, common.summary_file)
    return end([report], quiet=common.quiet)


@app.command
def check(
    *programs: Annotated[
        str, Parameter(help="Programs, folders of programs, and patterns such as 'parts/**/*.nc'.")
    ],
    format: Annotated[
        CheckFormat,
        option("What to print: a summary for people, JSON, or findings as other tools read them."),
    ] = "text",
    jobs: Annotated[
        int | None,
        Parameter(
            help="How many programs to check at once; one a core if left out.",
            validator=validators.Number(gte=1),
        ),
    ] = None,
    select: Annotated[
        tuple[str, ...], option("Of the warnings and notes show those of these codes alone.")
    ] = (),
    ignore: Annotated[
        tuple[str, ...], option("Don't show warnings and notes of these codes.")
    ] = (),
    fail_on: Annotated[
        Severity, option("The least severe finding that makes the exit code 1.")
    ] = "error",
    stock: Annotated[
        str | None,
        option(
            "The raw part, such as X0:100,Y0:60,Z-12:0 (mm, machine coordinates): no G0 into it."
        ),
    ] = None,
    portable: Annotated[
        tuple[str, ...],
        option("Dialects that have to read the program in the same way, such as grbl,linuxcnc."),
    ] = (),
    scheduler: Annotated[
        str | None,
        option("Check on a Dask cluster: its scheduler's address, such as tcp://host:8786."),
    ] = None,
    baseline: Annotated[
        str | None,
        option(
            "A summary that --json wrote before: what changed since, and new findings alone decide the exit code."
        ),
    ] = None,
    common: Common = COMMON,
) -> int:
    """Verify programs without a board: language, travel, the limits of the plan, the pulses."""
    names = [name.replace(HYPHEN, "-") for name in programs]
    common.check_outputs(
        *names, baseline, printing=format != "text" and (format, common.json) != ("json", "-")
    )
    files = find_programs(names)
    listed = len(files) != 1 or names != files
    shown = common.summary_file if format == "text" else sys.stderr
    before = None if baseline is None else Baseline(baseline)
    look = Look(
        stock,
        Selection(frozenset(codes(select)), frozenset(codes(ignore))),
        tuple(codes(portable)),
        jobs,
        scheduler,
    )
    reports = (
        check_listed(files, common, look, shown)
        if listed or scheduler
        else [check_one(files[0], common, look)]
    )
    if before is not None:
        for report in reports:
            report.changes = before.changes(report)
    for name in {common.json, "-" if format == "json" else None}:
        if name is not None:
            write_summary(name, reports if listed else reports[0])
    if format != "text" and format != "json":
        from cnc.outputs.findings import write_findings

        write_findings(format, reports)
    if not listed:
        show(reports[0], common, shown)
    if before is not None and not common.quiet:
        print(*change_lines(reports, before.missing(reports)), sep="\n", file=shown)
    return end(reports, quiet=common.quiet, fail_on=fail_on)


@app.command
def diff(
    first: Annotated[str, output("A program (- is standard input).")],
    second: Annotated[str, output("The one to compare with it.")],
    /,
    *,
    machine: Annotated[
        str | None, option("Machine file (TOML), or the name of a shipped one.")
    ] = None,
    dialect: Annotated[
        Dialect | None, option("How to read the programs; the machine file's choice if left out.")
    ] = None,
    json: Annotated[
        str | None, output("Write what is found to FILE.json (- is standard output).")
    ] = None,
    quiet: Annotated[bool, option("Say nothing but errors.")] = False,
) -> int:
    """Compare the motion of two programs, not their text: how far apart, where, how long."""
    if first == second == "-":
        raise UsageError(
            Diagnostic(
                "usage", "standard input holds one program", hint="name a file for the other one"
            )
        )
    library()
    from cnc.compare.programs import compare
    from cnc.machine.load import load_machine
    from cnc.outputs.summary_json import write_object

    Common(machine=machine, json=json).check_outputs(first, second)
    with Screen(Control(), quiet=quiet) as screen:
        found = compare(first, second, load_machine(machine), dialect, screen.watch())
    if all(report.ok and report.stopped_at_line is None for report in found.reports):
        if json is not None:
            write_object(json, found.as_json())
        if not quiet:
            print(*found.lines(), sep="\n", file=sys.stderr if json == "-" else sys.stdout)
    return end(found.reports, quiet=quiet)


@app.command
def view(
    program: Annotated[str, output("The program (- is standard input).")],
    /,
    *,
    output: Annotated[
        str,
        Parameter(
            name=["--output", "-o"],
            help="The picture: a page to turn and play (.html), or a .png or .svg.",
        ),
    ],
    stock: Annotated[
        str | None,
        option("The raw part to draw, such as X0:100,Y0:60,Z-12:0 (mm, machine coordinates)."),
    ] = None,
    common: Common = COMMON,
) -> int:
    """Draw a program: its path in space, its feed, acceleration and jerk over time, its text beside
    them.
    """
    common.check_outputs(program, picture=output)
    report = check_one(program, common, Look(stock), output)
    if common.json is not None:
        write_summary(common.json, report)
    show(report, common, common.summary_file)
    if report.ok and report.stopped_at_line is None and not common.quiet:
        print(f"picture      {output}", file=common.summary_file)
    return end([report], quiet=common.quiet)


@app.command
def boards(
    *ports: Annotated[
        str,
        Parameter(
            help="Ports to look at, pyserial URLs too; all serial ports of this computer if left out."
        ),
    ],
    baud: Annotated[
        int,
        option(
            "Bits a second of the links; stepper boards are asked at 1000000 if this is too slow for them."
        ),
    ] = 115200,
) -> int:
    """List the serial ports and what answers on each.

    A GRBL board with its settings and the machine file that they make (redirect it into a file), a
    stepper board with its version, axes, tick and room, something else, or nothing. The first
    opening of a port resets most boards; nothing moves.
    """
    from cnc.boards.discovery import port_report, probe_ports

    found = probe_ports(ports, baud)
    for each in found:
        print(*port_report(each, baud), sep="\n", flush=True)
    if not found:
        print("# this computer has no serial port; is the board plugged in and switched on?")
    return next((fail(each.fault) for each in found if ports and each.fault is not None), 0)


@app.command
def home(
    *axes: Annotated[str, Parameter(help="Axes to home; all that have a switch if left out.")],
    machine: Annotated[
        str | None, option("Machine file (TOML), or the name of a shipped one.")
    ] = None,
    board: Annotated[str | None, option("The board; the machine file's if left out.")] = None,
    port: Annotated[
        str | None, option("Where the board is (/dev/ttyUSB0); the machine file's if left out.")
    ] = None,
    quiet: Annotated[bool, option("Say nothing but errors.")] = False,
) -> int:
    """Let the machine find out where it stands by its limit switches.

    With a stepper board each axis goes to its switch, twice, and off it. A GRBL board homes all
    axes by its own cycle ($H).
    """
    api = library()
    control = Control()
    with Screen(control, quiet=quiet) as screen, Keys(control):
        stands = api.home(
            machine,
            axes,
            board=board,
            port=port,
            watch=screen.watch(),
            control=control,
            on_axis=None if quiet else lambda axis: print(axis.description, flush=True),
        )
    if not quiet:
        from cnc.report.summary import position

        places = [
            f"{axis.upper()}{position(value)}"
            for axis, value in stands.items()
            if value is not None
        ]
        print("the machine stands at", *places)
        lost = [axis.upper() for axis, value in stands.items() if value is None]
        if lost:
            print("not known:", *lost)
    return 0


@app.command
def papers(
    folder: Annotated[Path, Parameter(help="Where the page and its figures go.")] = Path("papers"),
    /,
    *,
    quiet: Annotated[bool, option("Do not print the tables.")] = False,
) -> int:
    """Run the experiments of the papers that the interpolators come from: tables and figures,
    published beside ours.
    """
    from cnc.cli.progress import tell_compiling
    from cnc.papers import page
    from cnc.papers.contents import sections
    from cnc.session.kernel_cache import ensure_compiled

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


def main(arguments: Sequence[str] | None = None) -> None:
    """The program ``cncrun``: carry out and exit. Codes: 0 well, 1 program, 2 usage, 3 board, 130
    stopped; 1 for an internal error, too.
    """
    # A file's name need not be text; it must not end the run, as little as its contents.
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    sys.exit(exit_code(sys.argv[1:] if arguments is None else arguments))


def exit_code(arguments: Sequence[str]) -> int:
    """Carry out a command line; whatever is raised becomes a message and a code."""
    try:
        result = app(
            [HYPHEN if each == "-" else each for each in arguments],
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except CycloptsError as error:
        return fail(
            UsageError(
                Diagnostic(
                    "usage", usage(error), hint="cncrun --help lists the commands and options"
                )
            )
        )
    except CncError as error:
        return fail(error)
    except HomingStopped as stop:
        print(stop, file=sys.stderr)
        return EXIT_STOPPED
    except KeyboardInterrupt as stop:
        print(str(stop) or "stopped by the operator; nothing has moved", file=sys.stderr)
        return EXIT_STOPPED
    except BrokenPipeError:
        # Python flushes standard output once more at its end: give it something to flush to.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE
    except Exception as error:
        return internal_error(error, "--verbose" in arguments)

"""The command ``cncrun serve``: the operator's console in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from cnc.cli.options import MachineOption, TerminalOptions, library, option
from cnc.model.diagnostics import Diagnostic, UsageError

if TYPE_CHECKING:
    from cnc.server.serve import Address

TERMINAL = TerminalOptions()


def serve(
    *,
    host: Annotated[
        str, option("Address to listen at; with any other than this, a token is compulsory.")
    ] = "127.0.0.1",
    port: Annotated[
        int,
        Parameter(
            help="Port to listen at; 0 for a free one, which the first line names.",
            validator=validators.Number(gte=0, lte=65535),
        ),
    ] = 8080,
    token: Annotated[
        str | None, option("Token of every request; by default a new one where one is needed.")
    ] = None,
    folder: Annotated[
        str | None,
        Parameter(name="--library", help="Folder of the jobs, with a folder of macros."),
    ] = None,
    machine: MachineOption = None,
    terminal: TerminalOptions = TERMINAL,
) -> int:
    """Serve the operator's console: jog, zero, check, run.

    It needs the extra: pip install 'cncrun[serve]'. It ends with Ctrl-C; the machine comes to rest.
    """
    terminal.open_log(machine)
    known = library().load_machine(machine)
    try:
        from cnc.server import serve as server
    except ImportError as error:
        message = f"the console needs {error.name}, which is not installed"
        hint = "pip install 'cncrun[serve]'"
        raise UsageError(Diagnostic("serve-missing", message, hint=hint)) from error
    from cnc.model.state_folder import folder as state_folder

    def announce(address: Address) -> None:
        print(address.link, flush=True)
        if address.access.token is not None and not terminal.quiet:
            print(server.qr_code(address.link), flush=True)
        if not terminal.quiet:
            print(
                "This console is no emergency stop: the machine needs one of its own.", flush=True
            )

    place = Path(folder) if folder is not None else state_folder().parent / "jobs"
    server.serve(known, server.open_address(host, port, token), place, announce=announce)
    return 0

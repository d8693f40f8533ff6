"""The command line: options to :mod:`cnc.api`, a report to text and an exit code.

Whatever happens, the last thing on standard error is a message that says what, where and what to
do, never a traceback. What takes long to import is imported when it is needed: ``cncrun --help``
has to be quick, and a signal ends the program with a message from its first moments on.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable, Sequence

from cnc.cli.signals import prepare_streams

__all__ = ["exit_code", "main"]


def main() -> None:
    """Carry out the command line, and exit.

    Exit codes: 0 success, 1 program rejected or internal error, 2 usage, 3 board, 130 stopped.
    """
    prepare_streams()
    _serve_signals()
    gc.disable()  # nothing of what is imported here is garbage
    try:
        carry_out = _commands()
    except KeyboardInterrupt:
        # No command has begun yet, which would print this.
        print("stopped by the operator; nothing has moved", file=sys.stderr)
        raise SystemExit(130) from None
    finally:
        gc.freeze()
        gc.enable()
    code = carry_out(sys.argv[1:])
    # The memory of the process ends with it, so Python need not search it for garbage.
    gc.freeze()
    sys.exit(code)


def _serve_signals() -> None:
    """Let signals end the program as Ctrl-C does, until a command serves them."""
    terminals = [file for file in (1, 2) if os.isatty(file)]

    def hung_up(*_: object) -> None:
        # Writing to a closed terminal is an error.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for file in terminals:
            os.dup2(nowhere, file)
        os.close(nowhere)
        raise KeyboardInterrupt

    handlers: dict[str, Callable[..., object]] = {
        "SIGTERM": signal.default_int_handler,
        "SIGHUP": hung_up,
        "SIGBREAK": hung_up,
    }
    for name, handler in handlers.items():
        number = getattr(signal, name, None)
        # nohup ignores SIGHUP.
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def exit_code(arguments: Sequence[str]) -> int:
    """Carry out a command line; return its exit code. Errors are printed as messages."""
    return _commands()(arguments)


def _commands() -> Callable[[Sequence[str]], int]:
    """Import the commands; return the function that carries out a command line."""
    from cnc.cli import commands  # after the signals are served

    return commands.exit_code

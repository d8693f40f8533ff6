"""Messages of a command: its log, its errors, and the exit codes of these.

A log goes to a file in full, and to standard error with ``--verbose``. The modules log to loggers
of their own names (``cnc.session.session``, ``cnc.boards.grbl.link``). Nothing is printed by
default.

    INFO     stages of the run with their times, operator requests, findings, the result
    DEBUG    each line or frame that is sent to a board or received from it
"""

from __future__ import annotations

import logging
import platform
import sys
import traceback
from contextlib import suppress

from cyclopts import CycloptsError, UnusedCliTokensError

from cnc.model.diagnostics import EXIT_REJECTED, CncError, Diagnostic, UsageError
from cnc.version import __version__

FORMAT = "%(asctime)s.%(msecs)03d %(levelname)-7s %(name)s: %(message)s"
TIME_FORMAT = "%Y-%m-%d %H:%M:%S"

log = logging.getLogger(__name__)

_root = logging.getLogger("cnc")
_handlers: list[logging.Handler] = []


class _StandardError(logging.Handler):
    """Prints each record to the present ``sys.stderr``, which a progress bar may replace."""

    def emit(self, record: logging.LogRecord) -> None:
        print(self.format(record), file=sys.stderr, flush=True)


class _LogFile(logging.FileHandler):
    """The file of the log. A full disk ends the log with one warning, and never the run."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Report that the log ends here."""
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):
            super().handleError(record)
            return
        _root.removeHandler(self)
        message = f"{self.baseFilename} cannot be written: {error.strerror or error}"
        hint = "the log ends here; choose a file on a disk that has space"
        found = Diagnostic("log-ends", message, hint=hint, severity="warning")
        print(f"{found.severity}: {found.render()}", file=sys.stderr)

    def close(self) -> None:
        """Close the file. What a full disk did not take is lost, which was reported."""
        with suppress(OSError):
            super().close()


def open_log(file: str | None, *, verbose: bool) -> None:
    """Begin to log.

    Args:
        file: The file to write, or None.
        verbose: Whether to print the stages to standard error.

    Raises:
        UsageError: ``can-not-write``.
    """
    close_log()
    if file is not None:
        try:
            handler: logging.Handler = _LogFile(file, "w", encoding="utf-8")
        except OSError as error:
            message = f"{file} cannot be written: {error.strerror or error}"
            hint = "choose a file in a folder that you may write to"
            raise UsageError(Diagnostic("can-not-write", message, hint=hint)) from error
        _add(handler, logging.DEBUG)
    if verbose:
        _add(_StandardError(), logging.INFO)
    log.info("cncrun %s, Python %s, %s", __version__, platform.python_version(), sys.platform)


def close_log() -> None:
    """End the log."""
    for handler in _handlers:
        _root.removeHandler(handler)
        handler.close()
    _handlers.clear()
    _root.setLevel(logging.NOTSET)


def _add(handler: logging.Handler, level: int) -> None:
    handler.setLevel(level)
    handler.setFormatter(logging.Formatter(FORMAT, TIME_FORMAT))
    _handlers.append(handler)
    _root.addHandler(handler)
    _root.setLevel(min(level, _root.level or level))


EXIT_PIPE = 141
"""The reader of the output went away: 128 + SIGPIPE, as a shell reports it for other tools."""


def usage(error: CycloptsError) -> str:
    """Return the fault of a command line in one line."""
    if isinstance(error, UnusedCliTokensError):
        unused = " ".join(error.unused_tokens or [])
        return (
            f"cncrun runs one program, {unused} is too much; "
            "several can be checked: cncrun check PROGRAM..."
        )
    return " ".join(str(error).split())


def fail(error: CncError) -> int:
    """Print an error; return its exit code."""
    sys.stdout.flush()
    log.error("%s", error.diagnostic.render())
    print(error.diagnostic.render(), file=sys.stderr)
    return error.exit_code


def internal_error(error: Exception, verbose: bool) -> int:
    """Print an error of cncrun itself; return its exit code."""
    log.critical("internal error", exc_info=error)
    if verbose:
        traceback.print_exception(error)
    message = f"cncrun failed: {type(error).__name__}: {error}"
    hint = (
        "please report the program, the machine file and this message; --verbose shows where it "
        "happened, --log FILE also what led to it"
    )
    print(Diagnostic("internal-error", message, hint=hint).render(), file=sys.stderr)
    return EXIT_REJECTED

"""The beginning and the end of a session in the log."""

from __future__ import annotations

import logging

from cnc.model.shown_text import printable
from cnc.report.result import Report
from cnc.session.context import SessionContext

log = logging.getLogger(__name__)


def log_begin(context: SessionContext, report: Report) -> None:
    """Log the program, the machine and the options."""
    machine = context.reader.machine
    log.info("program %s", printable(report.program))
    log.info(
        "machine %s, board %s, dialect %s",
        machine.name,
        report.board or "none",
        context.reader.dialect,
    )
    log.debug("%s", context.options)
    log.debug("%r", machine)


def log_end(context: SessionContext, report: Report) -> None:
    """Log the operator's requests, the faults and how the session ended."""
    context.observer.log_requests()
    for fault in report.faults:
        log.error("%s", fault.diagnostic.render())
    if report.stopped_at_line is not None:
        log.info("stopped at line %d; position %s", report.stopped_at_line, report.end_position)
    log.info(
        "end: %d faults, %d warnings, total %.3f s",
        len(report.faults) + report.hidden_faults,
        len(report.warnings) + report.hidden_warnings,
        report.timing.total_s,
    )

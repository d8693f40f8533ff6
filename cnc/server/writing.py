"""Requests that write: simple jobs, macros, and the findings of a text as it is typed."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from fastapi import APIRouter

from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.operate.program_session import macro_names
from cnc.server.console import Console
from cnc.server.library import OWN, checked, unfit_macro
from cnc.server.models import MOST_MACRO, Accepted, MacroText, NewJob, TypedText
from cnc.server.routes import Controlled, Shared
from cnc.simple_jobs.programs import described, written

router = APIRouter(prefix="/api")


def can_mill(console: Console) -> bool:
    """Return whether the simple jobs are for this machine."""
    machine = console.session.machine
    return machine.kind == "mill" and {"x", "y", "z"} <= set(machine.axes)


@router.get("/simple-jobs")
def simple_jobs(console: Shared) -> list[dict[str, Any]]:
    """Return the simple jobs and their parameters; none for a machine that is no mill."""
    return described() if can_mill(console) else []


@router.post("/simple-jobs/{kind}")
def write_simple_job(kind: str, body: NewJob, console: Shared) -> dict[str, str]:
    """Write the program of a simple job into the library."""
    library, name = console.library, checked(body.name)
    if not can_mill(console):
        message = "simple jobs are for a mill with X, Y and Z"
        raise UsageError(Diagnostic("job-kind", message, hint="upload a program"))
    text = written(kind, body.parameters, console.session.machine.program.dialect)
    console.refuse_change(name)
    if not body.replace and name in library.names():
        message = f"the library has {name} already"
        raise UsageError(Diagnostic("job-exists", message, hint="choose another name"))
    with tempfile.TemporaryDirectory(dir=library.folder / OWN) as folder:
        draft = Path(folder) / "draft"
        draft.write_text(text, encoding="utf-8")
        library.adopt(name, draft)
    console.jobs_changed()
    return {"name": name}


@router.post("/findings/{name}")
async def typed_findings(name: str, body: TypedText, console: Shared) -> list[dict[str, Any]]:
    """Return the findings of a text that is typed; no file is changed, and nothing is planned."""
    return await console.typed(name, body.text)


@router.get("/macros")
def macros(console: Shared) -> list[str]:
    """Return the names of the macros."""
    return macro_names(console.library.macros)


@router.get("/macros/{name}")
def macro_text(name: str, console: Shared) -> MacroText:
    """Return the text of a macro."""
    file = console.library.macro(name)
    if file.stat().st_size > MOST_MACRO:
        raise unfit_macro(f"{name} is too long to be changed here", "change it in an editor")
    return MacroText(text=file.read_text(encoding="utf-8", errors="replace"))


@router.put("/macros/{name}")
def write_macro(name: str, body: MacroText, console: Controlled) -> Accepted:
    """Write a macro. Its button then runs this text."""
    console.library.write_macro(name, body.text)
    console.macros_changed()
    return Accepted()


@router.delete("/macros/{name}")
def remove_macro(name: str, console: Controlled) -> Accepted:
    """Remove a macro."""
    console.library.macro(name).unlink()
    console.macros_changed()
    return Accepted()

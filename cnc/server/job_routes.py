"""The requests about jobs: upload, text, check, toolpath, run, history, log."""

from __future__ import annotations

import asyncio
import os
import tempfile
from pathlib import Path
from typing import Any

from fastapi import APIRouter, HTTPException, Query, Request
from fastapi.responses import FileResponse

from cnc.server.library import OWN, Library, checked
from cnc.server.models import Accepted, CheckJob, CutJob, LogText, RunJob, TextPart
from cnc.server.routes import Controlled, Shared
from cnc.server.upload import UploadDecoder
from cnc.session.options import RunOptions

router = APIRouter(prefix="/api")
MOST_LINES = 5000
"""Lines of a text in one answer."""
HISTORY_OF_JOB = 20


def _job(library: Library, name: str) -> dict[str, Any]:
    file = library.path(name)
    status = file.stat()
    runs = library.history(1, name)
    return {
        "name": name,
        "size": status.st_size,
        "changed": status.st_mtime,
        "outcome": runs[0]["outcome"] if runs else None,
    }


def _not_found(what: str) -> HTTPException:
    return HTTPException(404, {"code": "no-such-result", "message": what, "hint": ""})


@router.get("/jobs")
def jobs(console: Shared) -> list[dict[str, Any]]:
    """Return the jobs of the library."""
    library = console.library
    outcomes: dict[str, str] = {}
    for run in library.history():
        outcomes.setdefault(run["job"], run["outcome"])
    found = []
    for name in library.names():
        status = (library.folder / name).stat()
        found.append(
            {
                "name": name,
                "size": status.st_size,
                "changed": status.st_mtime,
                "outcome": outcomes.get(name),
            }
        )
    return found


@router.put(
    "/jobs/{name}",
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {
                    "schema": {
                        "type": "object",
                        "properties": {"text": {"type": "string"}},
                        "required": ["text"],
                    }
                }
            },
        }
    },
)
async def upload(name: str, request: Request, console: Shared) -> dict[str, Any]:
    """Write a program into the library: the body is ``{"text": "..."}``."""
    library = console.library
    console.refuse_change(checked(name))
    decoder = UploadDecoder()
    handle, draft = tempfile.mkstemp(dir=library.folder / OWN)
    try:
        with open(handle, "w", encoding="utf-8", errors="replace", newline="") as target:
            async for piece in request.stream():
                for text in decoder.feed(piece, last=not piece):
                    target.write(text)
                    # Other requests, and the machine, have their turn between two pieces.
                    await asyncio.sleep(0)
        library.adopt(name, Path(draft))
    finally:
        Path(draft).unlink(missing_ok=True)
    console.jobs_changed()
    return _job(library, name)


@router.get("/jobs/{name}")
async def job(name: str, console: Shared) -> dict[str, Any]:
    """Return a job with its last check and its last runs."""
    library = console.library
    found = _job(library, name)
    lines = await asyncio.to_thread(console.text, name)
    return found | {
        "lines": lines.total,
        "check": library.summary(name),
        "history": library.history(HISTORY_OF_JOB, name),
    }


@router.delete("/jobs/{name}")
def remove(name: str, console: Controlled) -> Accepted:
    """Remove a job."""
    console.remove(name)
    return Accepted()


@router.get("/jobs/{name}/text")
async def text(
    name: str,
    console: Shared,
    first: int = Query(default=1, ge=1),
    count: int = Query(default=1000, ge=1, le=MOST_LINES),
) -> TextPart:
    """Return lines of a program."""
    lines = await asyncio.to_thread(console.text, name)
    found = await asyncio.to_thread(lines.lines, first, count)
    return TextPart(first=first, lines=found, total=lines.total)


@router.post("/jobs/{name}/check")
def check(name: str, console: Shared, body: CheckJob | None = None) -> Accepted:
    """Begin a check."""
    console.check(name, None if body is None else body.height_map)
    return Accepted()


@router.get("/jobs/{name}/check")
def summary(name: str, console: Shared) -> dict[str, Any]:
    """Return the summary of the last check."""
    found = console.library.summary(name)
    if found is None:
        raise _not_found(f"{name} has not been checked since its last change")
    return found


@router.get("/jobs/{name}/toolpath")
def toolpath(name: str, console: Shared) -> FileResponse:
    """Return the toolpath of the last check."""
    library = console.library
    library.path(name)
    file = library.own(name, "path.json")
    if library.summary(name) is None or not file.is_file():
        raise _not_found(f"{name} has no toolpath: check it first")
    return FileResponse(file, media_type="application/json", stat_result=os.stat(file))


@router.get("/jobs/{name}/sketch")
def sketch(name: str, console: Shared) -> FileResponse:
    """Return a coarse picture of a long job, in the form of its toolpath."""
    console.library.path(name)
    file = console.library.own(name, "sketch.json")
    if not file.is_file():
        raise _not_found(f"{name} has no coarse picture: it is short, or not checked yet")
    return FileResponse(file, media_type="application/json", stat_result=os.stat(file))


@router.post("/jobs/{name}/cut")
def cut(name: str, body: CutJob, console: Shared) -> Accepted:
    """Begin to simulate the cut; its end is the event ``job-cut``."""
    console.cut(name, body.stock, body.resolution, body.system)
    return Accepted()


@router.get("/jobs/{name}/part")
def part(name: str, console: Shared) -> FileResponse:
    """Return the surface of the part that the last simulated cut left."""
    return _result(console.library, name, "part.json", "application/json")


@router.get("/jobs/{name}/stl")
def stl(name: str, console: Shared) -> FileResponse:
    """Return the part as an STL file."""
    return _result(console.library, name, "stl", "model/stl")


def _result(library: Library, name: str, kind: str, media_type: str) -> FileResponse:
    library.path(name)
    file = library.own(name, kind)
    if not file.is_file():
        raise _not_found(f"{name} has not been cut since its last change: POST .../cut first")
    return FileResponse(file, media_type=media_type, stat_result=os.stat(file))


@router.post("/jobs/{name}/run")
async def run(name: str, body: RunJob, console: Controlled) -> Accepted:
    """Check a job on the board, and run it."""
    height_map = body.height_map
    options = RunOptions(
        from_line=body.from_line,
        home=body.home,
        trust_position=body.trust_position,
        optional_stop=body.optional_stop,
        height_map=None if height_map is None else str(console.library.height_map_file(height_map)),
    )
    await console.run(name, options)
    return Accepted()


@router.get("/jobs/{name}/log")
def log(name: str, console: Shared) -> LogText:
    """Return the log of the last run."""
    return LogText(text=console.library.log(name))


@router.get("/history")
def history(console: Shared) -> list[dict[str, Any]]:
    """Return the runs, the latest first."""
    return console.library.history()

"""The requests about height maps: list, read, probe, remove."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from cnc.operate.height_mapping import Grid
from cnc.server.models import Accepted, ProbeGrid
from cnc.server.routes import Controlled, Shared, accepted

router = APIRouter(prefix="/api")


@router.get("/height-maps")
def height_maps(console: Shared) -> list[str]:
    """Return the names of the height maps."""
    return console.library.height_maps()


@router.get("/height-maps/{name}")
def height_map(name: str, console: Shared) -> dict[str, Any]:
    """Return a height map."""
    return console.library.height_map(name).model_dump(mode="json")


@router.delete("/height-maps/{name}")
def remove_height_map(name: str, console: Controlled) -> Accepted:
    """Remove a height map."""
    console.library.height_map_file(name).unlink()
    console.height_maps_changed(name)
    return Accepted()


@router.post("/height-maps/{name}/probe")
async def probe_height_map(name: str, body: ProbeGrid, console: Controlled) -> Accepted:
    """Begin to probe a grid; the event ``height-map`` ends it, and an alarm tells what failed."""
    grid = Grid(**body.model_dump(exclude={"system"}))
    return await accepted(await console.probe_grid(name, grid, body.system))

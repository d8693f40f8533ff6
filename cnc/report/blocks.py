"""Canonical blocks as JSON Lines: one object a move or command."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from cnc.model import blocks as canon
from cnc.model.motion_commands import apart
from cnc.model.units import per_minute
from cnc.report.targets import TextTarget, Writer


class BlockWriter(Writer[TextTarget]):
    """Writes canonical blocks, one JSON object a line.

    A block of a subroutine in another file than ``program`` has the key ``file``.
    """

    def __init__(self, name: str, axes: Sequence[str], program: str) -> None:
        super().__init__(TextTarget(name))
        self._axes = tuple(axes)
        self._program = program

    def write(self, block: canon.Block) -> None:
        """Write a block. A run of moves becomes one object a move."""
        source = {} if block.file == self._program else {"file": block.file}
        self._target.write(
            "".join(
                json.dumps(part | source, allow_nan=False) + "\n"
                for part in block_objects(block, self._axes)
            )
        )

    def passed(self, blocks: Iterable[canon.Block]) -> Iterator[canon.Block]:
        """Yield the same blocks and write each of them."""
        for block in blocks:
            self.write(block)
            yield block


def block_objects(block: canon.Block, axes: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield a canonical block as objects of the public schema, feeds per minute.

    Args:
        block: any block; a polyline gives one object for each of its moves.
        axes: names of the numbers of a position.
    """
    if isinstance(block, canon.Polyline) and block.commands is not None:
        for part in apart((block,)):
            yield from block_objects(part, axes)
        return
    if isinstance(block, canon.Polyline):
        for line, end, feed in zip(
            block.lines.tolist(), block.points.tolist(), block.feeds.tolist(), strict=True
        ):
            traverse = math.isnan(feed)
            yield {
                "line": line,
                "kind": "traverse" if traverse else "line",
                "end": dict(zip(axes, end, strict=True)),
                "feed": None if traverse else per_minute(feed),
            }
        return
    kind, fields = _FIELDS[type(block)]
    yield {
        "line": block.line,
        "kind": kind(block) if callable(kind) else kind,
        **fields(block, axes),
    }


def _arc(block: canon.ArcFeed, axes: Sequence[str]) -> dict[str, Any]:
    return {
        "plane": block.plane,
        "center": dict(zip(canon.PLANE_AXES[block.plane], block.center, strict=True)),
        "end": dict(zip(axes, block.end.tolist(), strict=True)),
        "radius": block.radius,
        "turns": block.turns,
        "feed": per_minute(block.feed),
    }


def _nurbs(block: canon.NurbsFeed, axes: Sequence[str]) -> dict[str, Any]:
    return {
        "degree": block.degree,
        "knots": block.knots.tolist(),
        "control_points": block.control_points.tolist(),
        "weights": block.weights.tolist(),
        "axes": list(axes),
        "feed": per_minute(block.feed),
    }


def _spindle(block: canon.Spindle, _: Sequence[str]) -> dict[str, Any]:
    constant = {"surface_speed": per_minute(block.surface_speed)} if block.surface_speed else {}
    least = {"least_rpm": block.least_rpm} if block.least_rpm else {}
    in_motion = {"with_motion": True} if block.with_motion else {}
    return {"state": block.state, "rpm": block.rpm, **constant, **least, **in_motion}


def _overrides(block: canon.Overrides, _: Sequence[str]) -> dict[str, Any]:
    return {
        "feed": block.feed,
        "spindle": block.spindle,
        "adaptive_feed": block.adaptive_feed,
        "feed_stop": block.feed_stop,
    }


def _wait(block: canon.WaitInput, _: Sequence[str]) -> dict[str, Any]:
    return {
        "number": block.number,
        "input": "analog" if block.analog else "digital",
        "mode": block.mode,
        "timeout": block.timeout,
    }


def _tip_control(block: canon.TipControl, axes: Sequence[str]) -> dict[str, Any]:
    position = dict(zip(axes, block.position.tolist(), strict=True))
    return {"offset": None if block.offset is None else list(block.offset), "position": position}


def _probe(block: canon.Probe, axes: Sequence[str]) -> dict[str, Any]:
    end = dict(zip(axes, block.end.tolist(), strict=True))
    return {
        "end": end,
        "feed": per_minute(block.feed),
        "towards": block.towards,
        "must": block.must,
    }


_FIELDS: dict[
    type[canon.Block],
    tuple[str | Callable[[Any], str], Callable[[Any, Sequence[str]], dict[str, Any]]],
] = {
    canon.ArcFeed: ("arc", _arc),
    canon.NurbsFeed: ("nurbs", _nurbs),
    canon.PathMode: (
        "path-mode",
        lambda block, _: {"control": block.control, "tolerance": block.tolerance},
    ),
    canon.Dwell: ("dwell", lambda block, _: {"seconds": block.seconds}),
    canon.Spindle: ("spindle", _spindle),
    canon.Orient: (
        "orient",
        lambda block, _: {
            "angle": block.angle,
            "direction": block.direction,
            "timeout": block.timeout,
        },
    ),
    canon.SpindleSync: (
        "spindle-sync",
        lambda block, _: {"pitch": block.pitch} | ({"angle": block.angle} if block.angle else {}),
    ),
    canon.Coolant: ("coolant", lambda block, _: {"mist": block.mist, "flood": block.flood}),
    canon.Tool: (
        lambda block: "tool" if block.change else "tool-in-spindle",
        lambda block, _: {"number": block.number},
    ),
    canon.TipControl: ("tip-control", _tip_control),
    canon.Stop: (
        lambda block: (
            "optional-stop" if block.optional else "pallet-stop" if block.pallet else "stop"
        ),
        lambda block, _: {},
    ),
    canon.End: ("end", lambda block, _: {}),
    canon.Abort: ("abort", lambda block, _: {}),
    canon.Message: ("message", lambda block, _: {"text": block.text}),
    canon.Overrides: ("overrides", _overrides),
    canon.DigitalOutput: (
        "digital-output",
        lambda block, _: {"number": block.number, "on": block.on, "with_motion": block.with_motion},
    ),
    canon.AnalogOutput: (
        "analog-output",
        lambda block, _: {
            "number": block.number,
            "value": block.value,
            "with_motion": block.with_motion,
        },
    ),
    canon.WaitInput: ("wait-input", _wait),
    canon.Probe: ("probe", _probe),
    canon.BoardCommand: ("board-command", lambda block, _: {"text": block.text}),
}

"""Points along a path lie on it, at the asked distance."""

import numpy as np
import pytest

from cnc.compare.programs import points_along
from cnc.model.blocks import ArcFeed, Polyline
from cnc.path.build import build


def test_points_along_a_path_lie_on_it():
    blocks = [
        Polyline("", 1, np.array([[4.0, 3.0, 0.0]]), np.array([1.0]), np.array([1], np.int32)),
        ArcFeed("", 2, "XY", (4.0, 8.0), np.array([4.0, 13.0, 2.0]), 5.0, 0.5, 1.0),
    ]
    (chunk,) = build(blocks, axes=("x", "y", "z"), start=np.zeros(3))
    points, owner = points_along(chunk, 0.5)
    assert owner.tolist() == [0] * 10 + [1] * int(np.ceil(np.hypot(5.0 * np.pi, 2.0) / 0.5))
    assert points[:10] == pytest.approx(np.linspace(0.1, 1.0, 10)[:, None] * [4.0, 3.0, 0.0])
    angle = np.linspace(0.0, np.pi, len(points) - 9)[1:]
    circle = np.stack(
        (4.0 + 5.0 * np.sin(angle), 8.0 - 5.0 * np.cos(angle), 2.0 * angle / np.pi), axis=1
    )
    assert points[10:] == pytest.approx(circle, abs=1e-9)
    assert points_along(chunk, 0.5, np.array([1]))[0].tolist() == points[10:].tolist()

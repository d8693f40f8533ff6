"""The STL file is a closed surface around the part."""

from collections import Counter

import numpy as np
import pytest

from cnc.machine.models import Stock
from cnc.report.targets import BytesTarget
from cnc.stock import stl
from cnc.stock.kernels.sweep import BALL, Cutter
from cnc.stock.simulation import Material
from tests.stock.test_sweep import cut, path_of

STOCK = Stock(x=(1.0, 9.0), y=(-2.0, 4.0), z=(-3.0, 0.5))


@pytest.fixture
def part():
    material = Material(STOCK, 0.25)
    points = [(5.0, 3.0, -1.0), (8.0, 0.0, -4.0), (8.0, 9.0, -4.0)]
    cut(material, path_of(points, (0.0, 0.0, 1.0)), Cutter(BALL, 1.0, 0.0, 1.0))
    return material


def read(file):
    """Normals (n, 3) and corners (n, 3, 3) of an STL file."""
    data = file.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    assert len(data) == 84 + 50 * count
    table = np.frombuffer(data[84:], stl.TRIANGLE)
    return table["normal"].astype(float), table["corners"].astype(float)


def write(material, file):
    target = BytesTarget(str(file))
    count = stl.write_stl(material, target)
    target.close()
    return count


def test_each_edge_belongs_to_two_triangles_in_opposite_directions(part, tmp_path):
    file = tmp_path / "part.stl"
    count = write(part, file)
    _, corners = read(file)
    assert len(corners) == count
    edges = Counter()
    for triangle in corners:
        for k in range(3):
            edges[tuple(triangle[k]), tuple(triangle[(k + 1) % 3])] += 1
    # Where the part is cut through, top and bottom lie on each other.
    assert all(edges[b, a] == number for (a, b), number in edges.items())


def test_the_surface_encloses_the_volume_that_is_left(part, tmp_path):
    file = tmp_path / "part.stl"
    write(part, file)
    normals, corners = read(file)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    whole = 8.0 * 6.0 * 3.5
    assert volume == pytest.approx(whole - part.removed_volume(), rel=2e-2)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", cross, normals) >= -1e-6).all()
    box = corners.reshape(-1, 3)
    assert box.min(axis=0).tolist() == [1.0, -2.0, -3.0]
    assert box.max(axis=0).tolist() == [9.0, 4.0, 0.5]


def test_a_fine_grid_is_written_with_fewer_triangles(part, tmp_path, monkeypatch):
    monkeypatch.setattr(stl, "MOST_TRIANGLES", 400)
    file = tmp_path / "part.stl"
    assert write(part, file) < 1100 < 3532  # with two cells to a corner
    _, corners = read(file)
    assert corners[..., 2].min() == -3.0


def test_flat_places_take_few_triangles_and_the_same_volume(tmp_path):
    material = Material(STOCK, 0.02)
    # A face at Z0 with a rectangular pocket down to Z-2, along the cells.
    material.heights[:] = 0.0
    material.heights[100:200, 50:150] = -2.0
    file = tmp_path / "part.stl"
    assert write(material, file) < 300
    _, corners = read(file)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    # The walls lean between the centres of two cells, so the pocket is 2 mm wide and long.
    wide = 100 * 0.02
    assert volume == pytest.approx(8.0 * 6.0 * 3.0 - wide * wide * 2.0, rel=1e-3)

"""Height map files: round trip, schema, and what is refused."""

from __future__ import annotations

import json

import jsonschema
import pytest

from cnc.machine.height_map import (
    HeightMap,
    height_map_schema,
    height_map_text,
    load_height_map,
    save_height_map,
)
from cnc.model.diagnostics import UsageError
from tests.support.paths import ROOT

FOUND = HeightMap(
    x=(0.1, 5.0, 7.5),
    y=(-3.0, 4.0),
    heights=((0.01, -0.2, 1e-7), (0.3, 0.0, 0.12345678901234567)),
    interpolation="bicubic",
    system="G55",
    work_zero={"x": 1.0, "z": -2.0},
)


def test_a_file_gives_the_same_map_and_satisfies_the_schema(tmp_path):
    file = tmp_path / "map.json"
    save_height_map(FOUND, file)
    assert load_height_map(file) == FOUND
    jsonschema.validate(json.loads(file.read_text()), height_map_schema())
    assert len(file.read_text().splitlines()) == 5


def test_the_shipped_schema_is_that_of_the_model():
    """``cncrun schema height-map > docs/schemas/height-map.schema.json`` writes it."""
    shipped = ROOT / "docs" / "schemas" / "height-map.schema.json"
    assert json.loads(shipped.read_text(encoding="utf-8")) == height_map_schema()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"x": [0.1, 5.0, 5.0]}, "ascend"),
        ({"x": [0.1, 5.0]}, "2 rows of 2"),
        ({"heights": [[0, 0, 0]]}, "at least 2"),
        ({"heights": [[0, 0, 0], [0, 0]]}, "2 rows of 3"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"interpolation": "nearest"}, "interpolation"),
        ({"version": 2}, "version"),
        ({"colour": "red"}, "colour"),
        ({"y": [0.0, None]}, "y.1"),
    ],
)
def test_a_wrong_file_is_refused_with_its_key(tmp_path, changed, message):
    file = tmp_path / "map.json"
    file.write_text(json.dumps(json.loads(height_map_text(FOUND)) | changed))
    with pytest.raises(UsageError, match=message) as caught:
        load_height_map(file)
    assert caught.value.diagnostic.code == "height-map-file"


def test_a_number_that_is_not_finite_is_refused(tmp_path):
    file = tmp_path / "map.json"
    file.write_text(height_map_text(FOUND).replace("0.01", "NaN"))
    with pytest.raises(UsageError, match="height-map-file"):
        load_height_map(file)

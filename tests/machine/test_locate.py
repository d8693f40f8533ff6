"""Where a key stands in a TOML text."""

from cnc.machine.locate import locate
from cnc.machine.models import AXIS_LETTERS as MACHINE_LETTERS
from cnc.model.blocks import AXIS_LETTERS

TEXT = """top = 1
[a.b]
list = [
  1, # ]
  "[x = 3",
]
after = 2
  "quoted key" = 3
[ c ]
d.e = { f = 1, g = 2 }
"""


def at(*key):
    place = locate(TEXT, key)
    return place and (place.line, place.column, place.length)


def test_keys_are_found():
    assert at("top") == (1, 1, 3)
    assert at("a") == at("a", "b") == (2, 2, 3)
    assert at("a", "b", "list") == (3, 1, 4)
    assert at("a", "b", "after") == (7, 1, 5)
    assert at("a", "b", "quoted key") == (8, 3, 12)
    assert at("c") == (9, 3, 1)
    assert at("c", "d", "e") == (10, 1, 3)
    assert at("c", "d", "e", "g") == (10, 16, 1)


def test_a_key_that_is_not_there_gives_the_table_around_it():
    assert at("a", "b", "zzz") == (2, 2, 3)
    assert at("zzz") is None


def test_text_inside_an_array_is_no_key():
    assert at("a", "b", "x") == at("a", "b")


def test_the_machine_knows_the_axes_of_the_language():
    # canon and machine stand on one floor and do not import each other.
    assert MACHINE_LETTERS == AXIS_LETTERS

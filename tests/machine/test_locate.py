"""Locations of keys in a TOML text."""

from cnc.machine.load import locate

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
    found = locate(TEXT, key)
    return found and (found.line, found.column, found.length)


def test_keys_are_found():
    assert at("top") == (1, 1, 3)
    assert at("a") == at("a", "b") == (2, 2, 3)
    assert at("a", "b", "list") == (3, 1, 4)
    assert at("a", "b", "after") == (7, 1, 5)
    assert at("a", "b", "quoted key") == (8, 3, 12)
    assert at("c") == (9, 3, 1)
    assert at("c", "d", "e") == (10, 1, 3)
    assert at("c", "d", "e", "g") == (10, 16, 1)


def test_missing_key_gives_its_enclosing_table():
    assert at("a", "b", "zzz") == (2, 2, 3)
    assert at("zzz") is None


def test_text_inside_an_array_is_not_a_key():
    assert at("a", "b", "x") == at("a", "b")

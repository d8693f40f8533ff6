"""Programs that differ in spacing, case, order of words, units or distance mode have equal blocks.

So do two forms of the same curve.
"""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.gcode.reader.parser import parse_line
from cnc.gcode.reader.words import Word
from tests.support.gcode.gcode_cases import assert_rows_equal, rows, run
from tests.support.soak import share

DIGITS = st.decimals(-9999, 9999, places=4).map(lambda value: f"{value:f}")
SMALL = st.decimals(-99, 99, places=3)
BLANK = st.sampled_from(["", "", " ", "  ", "\t"])


@st.composite
def spaced(draw: st.DrawFn, text: str) -> str:
    """The same text with blanks between any two characters, and any case."""
    return "".join(draw(BLANK) + (char.lower() if draw(st.booleans()) else char) for char in text)


@given(st.data(), st.sampled_from("ABCXYZFIJKPQRSTUVWDEHL"), DIGITS)
def test_spacing_and_case_do_not_matter(data: st.DataObject, letter: str, digits: str) -> None:
    def read(text: str) -> list[tuple[str, float, str]]:
        return [(word.letter, word.number, word.written) for word in parse_line(text).words]

    plain = f"N12G1{letter}{digits}X.5(c)Y-0.25"
    loose = data.draw(spaced(plain.replace("(c)", "")))
    assert read(loose) == read(plain) == [
        ("N", 12.0, "N12"), ("G", 1.0, "G1"), (letter, float(digits), letter + digits),
            ("X", 0.5, "X.5"), ("Y", -0.25, "Y-0.25")
    ]  # fmt: skip


@given(
    st.data(),
    st.text("0123456789", min_size=1, max_size=25),
    st.text("0123456789", max_size=25),
    st.sampled_from(["", "+", "-"]),
)
def test_numbers_equal_float_of_their_digits(
    data: st.DataObject, whole: str, fraction: str, sign: str
) -> None:
    digits = sign + whole[-9:] + "." + fraction
    (word,) = parse_line(data.draw(spaced("X" + digits))).words
    assert word.number == float(digits)


@given(st.data())
def test_words_have_columns(data: st.DataObject) -> None:
    parts = [data.draw(spaced(text)) for text in ("G1", "X12.5", "Y-3", "(note)", "F60")]
    text = "".join(parts)
    words: tuple[Word, ...] = parse_line(text).words
    assert [text[word.column - 1].upper() for word in words] == ["G", "X", "Y", "F"]
    spelled = [text[word.column - 1 :][: word.length] for word in words]
    assert ["".join(part.split()).upper() for part in spelled] == [word.written for word in words]


@given(
    st.permutations(
        [
            "G1",
            "X10",
            "Y2",
            "F60",
            "S100",
            "M3",
            "T2",
            "M6",
            "M8",
            "G91",
            "G55",
            "G61",
            "M0",
            "(msg,a)",
            "G18",
        ]
    )
)
def test_the_order_of_words_does_not_matter(words: list[str]) -> None:
    usual = "G1 X10 Y2 F60 S100 M3 T2 M6 M8 G91 G55 G61 M0 (msg,a) G18"
    assert list(rows(run(" ".join(words)))) == list(rows(run(usual)))


moves = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(["G0", "G1"]), SMALL, SMALL, SMALL),
        st.tuples(st.sampled_from(["G2", "G3"]), SMALL, SMALL, st.decimals(1, 50, places=3)),
    ),
    min_size=1,
    max_size=12,
)  # fmt: skip


def program(path: list[tuple], *, inch: bool = False, incremental: bool = False) -> str:  # type: ignore[type-arg]
    """The same moves in another writing. Arcs are full turns of a helix, or R arcs that reach."""
    lines = [
        "G20" if inch else "G21",
        "G91" if incremental else "G90",
        f"F{600 / 25.4:.12f}" if inch else "F600",
    ]
    here = [0, 0, 0]

    def number(value: object) -> str:
        return f"{float(value) / 25.4:.15f}" if inch else f"{value}"  # type: ignore[arg-type]

    for code, x, y, third in path:
        if code in ("G0", "G1"):
            end = [x, y, third]
            words = zip(
                "XYZ",
                [b - a for a, b in zip(here, end, strict=True)] if incremental else end,
                strict=True,
            )
            lines.append(
                code + " " + " ".join(f"{letter}{number(value)}" for letter, value in words)
            )
        else:
            end = [here[0], here[1], x]
            lines.append(
                f"{code} Z{number(x - here[2] if incremental else x)} I{number(third)} "
                f"J{number(y)} P2"
            )
        here = end
    return "\n".join(lines)


@settings(max_examples=share(60, 12))
@given(moves)
def test_inches_give_equal_blocks(path: list[tuple]) -> None:  # type: ignore[type-arg]
    assert_rows_equal(
        list(rows(run(program(path, inch=True)))), list(rows(run(program(path)))), abs=1e-9
    )


@settings(max_examples=share(60, 12))
@given(moves)
def test_increments_give_equal_blocks(path: list[tuple]) -> None:  # type: ignore[type-arg]
    assert_rows_equal(
        list(rows(run(program(path, incremental=True)))), list(rows(run(program(path)))), abs=1e-9
    )


@settings(max_examples=share(60, 12))
@given(moves, SMALL, SMALL)
def test_an_offset_shifts_all_blocks(path: list[tuple], x: object, y: object) -> None:  # type: ignore[type-arg]
    """The moves in a system with an origin at (x, y) are those of the plain system from a start at
    (-x, -y), shifted.
    """
    import numpy as np

    origin = np.array([float(x), float(y), 0.0])  # type: ignore[arg-type]
    shifted = run(f"G10 L2 P2 X{x} Y{y}\nG55\n" + program(path), start=origin)
    plain = run(program(path))
    for a, b in zip(shifted, plain, strict=True):
        ends = [block.points if hasattr(block, "points") else block.end for block in (a, b)]  # type: ignore[attr-defined]
        assert np.allclose(ends[0], ends[1] + origin, atol=1e-9, rtol=0)


@settings(max_examples=share(60, 12))
@given(st.integers(1, 9), st.data())
def test_both_forms_of_a_nurbs_give_the_same_block(degree: int, data: st.DataObject) -> None:
    count = data.draw(st.integers(degree + 1, degree + 6))
    points = [
        (0, 0),
        *data.draw(st.lists(st.tuples(SMALL, SMALL), min_size=count - 1, max_size=count - 1)),
    ]
    weights = data.draw(st.lists(st.decimals("0.001", 9, places=3), min_size=count, max_size=count))
    spare = count - degree - 1
    inner = sorted(
        data.draw(
            st.lists(
                st.decimals("0.001", "0.999", places=3), min_size=spare, max_size=spare, unique=True
            )
        )
    )
    knots = [0] * (degree + 1) + inner + [1] * (degree + 1)

    def write(head: str, knot: str, weight: str) -> str:
        lines = [
            f"{knot}{u} X{x} Y{y} {weight}{w}"
            for u, (x, y), w in zip(knots, points, weights, strict=False)
        ]
        return "\n".join(
            [f"{head} {lines[0]} F60", *lines[1:], *(f"{knot}{u}" for u in knots[count:])]
        )

    paper = list(rows(run(write(f"G6.2 K{degree}", "U", "W"))))
    fanuc = list(rows(run(write(f"G06.2 P{degree + 1}", "K", "R"))))
    assert paper == fanuc
    assert paper[0][1:5] == (
        degree, [float(u) for u in knots], [[float(x), float(y), 0.0] for x, y in points],
            [float(w) for w in weights]
    )  # fmt: skip

"""Lines in groups: the same lines in the same order, as many at once as there is space for."""

from __future__ import annotations

import random

import pytest

from cnc.boards.grbl.messages import MOST_CHARACTERS, Rejected, kind_of
from cnc.boards.grbl.protocol import MOST_LINES, LineGroup, groups_of, single
from cnc.model.streams import PackedLines
from tests.support.boards.grbl_rig import ready
from tests.support.boards.line_reader import lines_with_effects

OTHERS = ["G4 P0.1", "M3 S100", "$H", "G10 L2 P1 X1", "G38.2 Z-1 F50", "(MSG, a)", "G91", "M0"]
LONG = f"X1({'a' * MOST_CHARACTERS})"


def mixed(seed: int) -> list[str]:
    rng = random.Random(seed)
    lines = ["G1 F600"]
    for _ in range(rng.randrange(1, 30)):
        run = rng.choice([1, 2, 5, MOST_LINES, MOST_LINES + 1, 300])
        lines += [f"X{rng.uniform(0, 9):.3f} Y{rng.randrange(9)}" for _ in range(run)]
        lines.append(rng.choice([*OTHERS, LONG]))
    return lines


@pytest.mark.parametrize("seed", range(8))
def test_groups_are_the_same_lines(seed: int) -> None:
    texts = mixed(seed)
    lines = list(lines_with_effects(texts))
    groups = list(groups_of(PackedLines.of(lines)))
    assert "".join(group.text for group in groups) == "".join(f"{text}\n" for text in texts)
    assert [line for group in groups for line in group.lines] == [line.line for line in lines]
    for group in groups:
        parts = [group.part(k, k + 1) for k in range(len(group))]
        assert "".join(parts) == group.text
        assert all(part.count("\n") == 1 and part.endswith("\n") for part in parts)
        assert len(group) == 1 or group.kind == "plain"
        assert len(group) <= MOST_LINES
        if group.text[:-1] in OTHERS:
            assert group.kind == kind_of(group.text[:-1])


def test_only_motions_follow_each_other() -> None:
    lines = ["G1 X1 F600", "X2", *OTHERS, "G1 X3", "Y4", LONG, "X5"]
    groups = groups_of(PackedLines.of(list(lines_with_effects(lines))))
    assert [len(group) for group in groups] == [2, *[1] * len(OTHERS), 2, 1, 1]


def test_as_many_lines_are_sent_as_fit() -> None:
    """128 bytes, of which one stays free and three are kept for a mark: 124."""
    protocol, lines = ready(), [f"X{k:09}" for k in range(20)]
    group = LineGroup(
        "plain", "".join(f"{line}\n" for line in lines), list(range(0, 221, 11)), list(range(20))
    )
    assert protocol.room(group) == 124 // 11 == 11
    assert protocol.send(group, 0, 11) == group.text[: 11 * 11].encode()
    assert protocol.room(group, 11) == 0
    protocol.receive(b"ok\r\nok\r\nok\r")
    assert (protocol.waiting, protocol.used, protocol.confirmed_line) == (9, 99, 1)
    assert protocol.room(group, 11) == 2
    assert protocol.room(group, 11, 10) == 1
    assert protocol.room(single("$X", 1)) == 0
    protocol.receive(b"\n")
    assert (protocol.waiting, protocol.confirmed_line) == (8, 2)


@pytest.mark.parametrize("answers", [b"ok\r\nok\r\n", b"ok\r\n[MSG:a]\r\nok\r\n"])
def test_a_refused_line_of_a_group_is_named(answers: bytes) -> None:
    protocol = ready()
    group = LineGroup("plain", "X1\nX2\nX3\nX4\n", [0, 3, 6, 9, 12], [5, 6, 6, 9])
    protocol.send(group, 0, 4)
    *_, rejected = protocol.receive(answers + b"error:2\r\n")
    assert isinstance(rejected, Rejected)
    assert (rejected.sent.text, rejected.sent.line) == ("X3", 6)
    assert protocol.confirmed_line == 6

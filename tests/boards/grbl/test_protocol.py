"""The protocol of a GRBL board: every documented message, in any pieces."""

from __future__ import annotations

import random
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.boards.grbl.messages import (
    UNNUMBERED,
    Alarm,
    Alarmed,
    Confirmed,
    Feedback,
    Firmware,
    Lost,
    Message,
    Messages,
    Other,
    Rejected,
    Reply,
    Report,
    Setting,
    Started,
    UnexpectedReply,
    Welcome,
    kind_of,
    message,
    seconds_of,
)
from cnc.boards.grbl.protocol import MARK_BYTES, GrblProtocol, State, single
from tests.support.boards.grbl_rig import WELCOME, ready

DOCUMENTED: list[tuple[str, Message]] = [
    ("ok", Reply()),
    ("error:9", Reply(9)),
    ("error:Invalid $ statement", Reply(UNNUMBERED, "Invalid $ statement")),
    ("ALARM:2", Alarm(2)),
    ("Grbl 1.1h ['$' for help]", Welcome("1.1h", Firmware.GRBL)),
    (
        "Grbl 3.7 [FluidNC v3.7.17 (wifi) '$' for help]",
        Welcome("3.7", Firmware.FLUID),
    ),
    ("GrblHAL 1.1f ['$' or '$HELP' for help]", Welcome("1.1f", Firmware.HAL)),
    ("<Idle|MPos:0.000,0.000,0.000|FS:0,0>", Report("Idle|MPos:0.000,0.000,0.000|FS:0,0")),
    ("$110=500.000", Setting(110, "500.000")),
    ("[MSG:Reset to continue]", Feedback("MSG", "Reset to continue")),
    ("[PRB:1.000,2.000,-3.000:1]", Feedback("PRB", "1.000,2.000,-3.000:1")),
    (
        "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]",
        Feedback("GC", "G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0"),
    ),
    ("[VER:1.1h.20190830:]", Feedback("VER", "1.1h.20190830:")),
    ("[OPT:V,15,128]", Feedback("OPT", "V,15,128")),
    ("[G54:1.000,0.000,0.000]", Feedback("G54", "1.000,0.000,0.000")),
    (">G54G20:ok", Other(">G54G20:ok")),
    (">:error:7", Other(">:error:7")),
    ("$N0=G54", Other("$N0=G54")),
    ("k", Other("k")),
    ("error:", Other("error:")),
]


@pytest.mark.parametrize(("line", "meaning"), DOCUMENTED)
def test_documented_messages(line: str, meaning: Message) -> None:
    assert message(line) == meaning


@given(st.lists(st.sampled_from(DOCUMENTED), max_size=12), st.integers(0, 2**32))
def test_messages_come_in_any_pieces(said: list[tuple[str, Message]], seed: int) -> None:
    data = b"".join(line.encode() + b"\r\n" for line, _ in said)
    pieces = random.Random(seed)
    reader, found = Messages(), []
    while data:
        n = pieces.randint(1, 9)
        found += reader.receive(data[:n])
        data = data[n:]
    assert found == [meaning for _, meaning in said]


@given(st.lists(st.binary(max_size=300), max_size=8), st.data())
def test_noise_does_not_break_the_protocol(noise: list[bytes], data: st.DataObject) -> None:
    protocol = ready()
    for piece in noise:
        if protocol.room(single("G1X1", 0)):
            protocol.send(single("G1X1", 1))
        if data.draw(st.booleans()) and protocol.mark_fits():
            protocol.mark()
        protocol.receive(piece)
        assert protocol.used >= 0
        assert (protocol.used == 0) == (protocol.waiting == 0)
    protocol.reset()
    # A line end, and the board's welcome is understood whatever came before.
    assert any(isinstance(event, Started) for event in protocol.receive(b"\n" + WELCOME))
    assert protocol.state is State.READY


@settings(max_examples=60)
@given(
    st.integers(32, 1024),
    st.lists(st.integers(1, 79), min_size=1, max_size=300),
    st.integers(0, 2**32),
)
def test_the_buffer_never_overflows_and_all_lines_arrive(
    rx: int, lengths: list[int], seed: int
) -> None:
    """A ring that holds one byte less than its size, and a board that answers at any time."""
    order = random.Random(seed)
    protocol = ready()
    protocol.rx_bytes = rx
    ring: deque[int] = deque()
    sent = answered = 0
    lines = ["G1" + "X" * max(min(length, rx - 6) - 2, 0) for length in lengths]
    while answered < len(lines):
        if sent < len(lines) and protocol.room(single(lines[sent], 0)):
            ring.append(len(protocol.send(single(lines[sent], sent + 1))))
            sent += 1
        elif ring:
            ring.popleft()
            (event,) = protocol.receive(b"ok\r\n")
            assert isinstance(event, Confirmed)
            answered += 1
            assert protocol.confirmed_line == answered
        assert sum(ring) <= rx - 1
        assert protocol.used == sum(ring)
        if ring and order.random() < 0.5:
            ring.popleft()
            protocol.receive(b"o")
            assert len(protocol.receive(b"k\r\n")) == 1
            answered += 1
    assert protocol.confirmed_line == len(lines)


def test_the_buffer_of_grbl_is_used_completely() -> None:
    protocol = ready()
    count = 0
    while protocol.room(single("G1X10.000Y10.000F1000Z1.0", 0)):
        protocol.send(single("G1X10.000Y10.000F1000Z1.0", count))
        count += 1
    # 128 bytes: four lines of 26 with their ends, and a mark
    assert (count, protocol.used) == (4, 104)
    assert protocol.mark_fits()


def test_a_line_for_which_there_is_no_space_is_not_sent() -> None:
    protocol = ready()
    while protocol.room(single("G1 X1", 0)):
        protocol.send(single("G1 X1", 1))
    used = protocol.used
    for text in ("G1 X1", "$X"):
        with pytest.raises(RuntimeError):
            protocol.send(single(text, 2))
    assert protocol.used == used


def test_a_line_longer_than_the_buffer_is_sent_alone() -> None:
    protocol = ready()
    protocol.rx_bytes = 32
    assert protocol.room(single("X" * 70, 0))
    protocol.send(single("X" * 70, 1))
    assert not protocol.room(single("X", 0))


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("G1 X1 F100", "plain"),
        ("$110=500", "writer"),
        ("$N0=G54", "writer"),
        ("$RST=#", "writer"),
        ("$I=mill", "writer"),
        ("G10 L2 P1 X0", "writer"),
        ("g10l20p1x0", "writer"),
        ("G28.1", "writer"),
        ("G30.1", "writer"),
        ("G28", "plain"),
        ("G92.1", "plain"),
        ("G1 X0.1", "plain"),
        ("$H", "system"),
        ("$X", "system"),
        ("$$", "system"),
        ("$J=G91X1F100", "plain"),
        ("M0", "pause"),
        ("M00 (MSG, put in tool 3, then resume)", "pause"),
        ("M6 T1", "pause"),
        ("M3 S1000", "spindle"),
        ("M30", "plain"),
        ("M2", "plain"),
        ("G38.2 Z-10 F50", "probe"),
        ("G4 P2.5", "dwell"),
        ("G04P0", "dwell"),
        ("G1 X1 (G10 L2 P1)", "plain"),
        ("G1 X1 ; M3", "plain"),
        ("G43.1 Z1", "plain"),
    ],
)
def test_kinds_of_lines(text: str, kind: str) -> None:
    assert kind_of(text) == kind


def test_seconds_of_a_dwell() -> None:
    assert seconds_of("G4 P2.5") == 2.5
    assert seconds_of("G4") == 0.0
    assert seconds_of("G4 P1.2.3") == 0.0
    assert seconds_of("G1 X1") == 0.0
    assert seconds_of("$h") > 100.0


@given(
    st.lists(
        st.sampled_from(["G1X1", "$110=5", "G10L2P1X1", "$H", "G28.1"]), min_size=1, max_size=30
    )
)
def test_writers_and_system_commands_are_sent_alone(lines: list[str]) -> None:
    protocol, under_way = ready(), deque()
    for text in lines:
        while not protocol.room(single(text, 0)):
            under_way.popleft()
            protocol.receive(b"ok\r\n")
        protocol.send(single(text, 1))
        under_way.append(text)
        assert len(under_way) == 1 or all(kind_of(each) == "plain" for each in under_way)


def test_an_error_belongs_to_the_oldest_line() -> None:
    protocol = ready()
    for line in (7, 8, 9):
        protocol.send(single("G1X1", line))
    events = protocol.receive(b"ok\r\nerror:20\r\nok\r\nerror:20\r\n")
    assert isinstance(events[0], Confirmed)
    assert isinstance(events[1], Rejected)
    assert (events[1].sent.line, events[1].reply) == (8, Reply(20))
    assert len(events) == 2
    assert not protocol.room(single("G1X1", 0))
    assert protocol.confirmed_line == 7


def test_a_late_ok_after_the_reset_is_not_counted() -> None:
    protocol = ready()
    protocol.send(single("G1X1", 1))
    protocol.reset()
    assert protocol.receive(b"ok\r\n") == []
    assert [type(event) for event in protocol.receive(b"ALARM:3\r\n" + WELCOME)] == [
        Alarmed,
        Started,
    ]
    assert (protocol.waiting, protocol.used) == (0, 0)
    assert protocol.room(single("G1X1", 0))


@pytest.mark.parametrize(
    ("before", "said", "after"),
    [
        (State.UNKNOWN, b"ok\r\n", State.UNKNOWN),
        (State.UNKNOWN, b"ALARM:1\r\n", State.UNKNOWN),
        (State.UNKNOWN, WELCOME, State.READY),
        (State.READY, b"ALARM:1\r\n", State.FAILED),
        (State.READY, b"ok\r\n", State.FAILED),
        (State.READY, WELCOME, State.FAILED),
        (State.FAILED, b"ok\r\n", State.FAILED),
        (State.FAILED, WELCOME, State.FAILED),
        (State.RESETTING, b"error:9\r\n", State.RESETTING),
        (State.RESETTING, b"ALARM:3\r\n", State.RESETTING),
        (State.RESETTING, WELCOME, State.READY),
    ],
)
def test_states(before: State, said: bytes, after: State) -> None:
    protocol = GrblProtocol()
    protocol.state = before
    protocol.receive(said)
    assert protocol.state is after


def test_unexpected_replies_and_restarts_are_events() -> None:
    assert ready().receive(b"ok\r\n") == [UnexpectedReply(0)]
    (event,) = ready().receive(WELCOME)
    assert isinstance(event, Started)
    assert not event.expected


@settings(max_examples=60)
@given(st.integers(1, 60), st.integers(0, 59), st.sampled_from([5, 20]))
def test_a_lost_answer_is_found_by_the_next_mark(count: int, lost: int, every: int) -> None:
    """A board that answers at once, except for one lost answer."""
    lost %= count
    protocol = ready()
    protocol.rx_bytes = 4096
    found = None
    for line in range(1, count + 1):
        protocol.send(single("G1X1", line))
        events = protocol.receive(b"" if line == lost + 1 else b"ok\r\n")
        if (line % every == 0 or line == count) and protocol.mark_fits():
            protocol.mark()
            events += protocol.receive(b"[GC:G1 F0 S0]\r\nok\r\n")
        found = next((event for event in events if isinstance(event, Lost)), None)
        if found is not None:
            break
    assert found is not None
    assert found.after < lost + 1 <= found.until
    assert found.until - found.after <= every


def test_a_mark_that_is_answered_in_order_shows_no_fault() -> None:
    protocol = ready()
    protocol.send(single("G1 X1 F1500", 1))
    protocol.mark()
    protocol.send(single("G1 X2", 2))
    assert [
        type(event) for event in protocol.receive(b"ok\r\n[GC:G1 G54 F1500 S0]\r\nok\r\nok\r\n")
    ] == [Confirmed, Confirmed]
    assert protocol.state is State.READY
    assert not protocol.marked


@pytest.mark.parametrize(
    ("told", "fine"),
    [("F1500 S0", True), ("F1500. S0.", True), ("F150 S0", False), ("F1500 S12000", True)],
)
def test_a_mark_shows_whether_the_feed_arrived(told: str, fine: bool) -> None:
    protocol = ready()
    protocol.send(single("G1 X1 F1500.4", 1))
    protocol.mark()
    events = protocol.receive(f"ok\r\n[GC:G1 G54 {told}]\r\nok\r\n".encode())
    assert any(isinstance(event, Lost) for event in events) is not fine


@pytest.mark.parametrize("behind", [b"", b"ok\r\n", b"[GC:G1 F500 S0]\r\nok\r\n"])
def test_a_refused_mark_is_removed(behind: bytes) -> None:
    """Half a line before it made one line of both, and the board continues."""
    protocol = ready()
    protocol.send(single("G1X1", 1))
    protocol.mark()
    events = protocol.receive(b"ok\r\nerror:3\r\n" + behind)
    rejected = [event for event in events if isinstance(event, Rejected)]
    assert [event.sent.text for event in rejected] == ["$G"]
    assert protocol.state is State.FAILED


def test_one_mark_of_three_bytes_at_a_time() -> None:
    protocol = ready()
    assert protocol.mark() == b"$G\n"
    assert protocol.used == MARK_BYTES == 3
    assert not protocol.mark_fits()

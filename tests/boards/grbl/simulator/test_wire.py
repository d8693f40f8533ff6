"""The simulator's serial side: full rings, EEPROM writes, real-time bytes, times of bytes."""

import math

import pytest

from cnc.simulators.grbl.firmware import LINE_TIME_A_BYTE
from cnc.simulators.grbl.firmware_profile import GRBL, GRBLHAL
from tests.support.boards.simulator_bench import BYTE, Bench


def busy_bench(profile=GRBL):
    """A board whose program waits for a long dwell."""
    bench = Bench(profile)
    bench.send("G4P20\n", 0.5)
    return bench


@pytest.mark.parametrize(("profile", "capacity"), [(GRBL, 128), (GRBLHAL, 1023)])
@pytest.mark.parametrize("over", [-1, 0, 1, 51, 200])
def test_a_full_ring_loses_further_bytes(profile, capacity, over):
    bench = busy_bench(profile)
    bench.send(b"\n" * (capacity + over), 1.0)
    lost = max(over, 0)
    assert bench.simulator.lost == bench.simulator.core.receiver.overflowed == lost
    assert bench.simulator.fullest == min(capacity, capacity + over)
    assert bench.hear(30.0).count("ok") == 1 + capacity + over - lost


def test_an_overflow_merges_lines():
    """Of 200 bytes 128 stay, and the line that is cut runs into the next."""
    bench = busy_bench()
    burst = b"G1X1.000Y2.000F900\n" * 11
    bench.send(burst[:200], 1.0)
    assert bench.simulator.lost == 72
    heard = bench.hear(30.0)
    assert heard.count("ok") == 1 + 128 // 19
    assert bench.send("G1X5\n") == ["error:24"]


def test_realtime_bytes_pass_a_full_ring():
    bench = busy_bench()
    bench.send(b"\n" * 200, 0.5)
    assert bench.status()["state"] == "Idle"
    assert bench.simulator.lost == 72
    assert any(line.startswith("Grbl") for line in bench.send(b"\x18", 0.5))


def test_bytes_take_ten_bits_each():
    bench = Bench()
    start = bench.simulator.now
    bench.port.write(b"\n")
    bench.port.read(1.0)
    # One byte there, four back, 30 us of work, and the next USB frame of 1 ms.
    assert 5 * BYTE + 30e-6 <= bench.simulator.now - start <= 5 * BYTE + 30e-6 + 0.001 + 1e-9


def test_an_eeprom_write_loses_what_arrives():
    """G10 with three new numbers writes up to 13 bytes in 3.4 ms each.

    Two bytes of the wire are kept in each 3.4 ms.
    """
    bench = Bench()
    bench.port.write(b"G10L2P1X1.5Y-2.7Z3.1\n" + b"G1X1F100\n" * 12)
    bench.hear(5.0)
    written = int(next(event.value for event in bench.simulator.events if event.kind == "eeprom"))
    assert 3 < written <= 13
    window = 0.0034 / BYTE
    before = LINE_TIME_A_BYTE * 21 // BYTE
    came_meanwhile = min(written * window, 108 - before)
    assert bench.simulator.core.receiver.blinded == came_meanwhile - 2 * math.ceil(
        came_meanwhile / window
    )
    assert bench.simulator.core.receiver.overflowed == 0


def test_an_eeprom_write_alone_loses_nothing():
    bench = Bench()
    for number in range(10):
        assert bench.reply(f"G10L2P1X{number}.5Y-2.7Z{number}") == "ok"
    assert bench.simulator.lost == 0


def test_writing_equal_bytes_takes_no_time():
    bench = Bench()
    bench.port.write(b"G10L2P1X0Y0Z0\n" + b"G4P0\n" * 12)
    assert bench.hear(1.0).count("ok") == 13
    assert bench.simulator.lost == 0


def test_check_mode_is_limited_by_the_wire():
    """26-byte lines at 115200 baud: 443 a second, all of them answered."""
    bench = Bench()
    bench.send("$C\n")
    line = b"G1X123.4567Y123.4567F1000\n"
    assert len(line) == 26
    start = bench.simulator.now
    waiting = oks = sent = 0
    while oks < 400:
        while sent < 400 and waiting + 26 <= 128:
            bench.port.write(line)
            waiting, sent = waiting + 26, sent + 1
        answers = bench.port.read(1.0).count(b"\n")
        oks, waiting = oks + answers, waiting - 26 * answers
    assert 400 / (bench.simulator.now - start) == pytest.approx(443, rel=0.02)
    assert bench.simulator.lost == 0

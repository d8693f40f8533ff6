"""Status reports of a GRBL board, whole and damaged, and the meanings of its codes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.boards.grbl.faults import ALARMS, ERRORS, alarm_meaning, error_meaning
from cnc.boards.grbl.messages import Firmware, Reported, StatusReader
from cnc.boards.grbl.protocol import single
from tests.support.boards.grbl_rig import ready

FIELDS = {
    "MPos": "1.000,2.000,3.000",
    "FS": "500,8000",
    "Bf": "15,128",
    "Pn": "PZ",
    "Ov": "110,50,100",
    "WCO": "0.500,0.000,0.000",
    "Ln": "9",
}


@given(st.permutations(sorted(FIELDS)), st.sets(st.sampled_from(sorted(set(FIELDS) - {"MPos"}))))
def test_status_fields_in_any_order_and_number(order: list[str], left_out: set[str]) -> None:
    text = "|".join(
        ["Hold:1", *(f"{name}:{FIELDS[name]}" for name in order if name not in left_out)]
    )
    status = StatusReader().read(text)
    assert status is not None
    assert (status.state, status.phase, status.position) == ("Hold", 1, (1.0, 2.0, 3.0))
    assert status.offset == (None if "WCO" in left_out else (0.5, 0.0, 0.0))
    assert status.overrides == (None if "Ov" in left_out else (110, 50, 100))
    assert status.free == (None if "Bf" in left_out else (15, 128))
    assert status.feed == (None if "FS" in left_out else 500.0)
    assert status.pins == ("" if "Pn" in left_out else "PZ")
    assert not status.at_rest


def test_fields_that_are_not_repeated_are_kept() -> None:
    reader = StatusReader()
    assert reader.read("Idle|WPos:1.000,1.000,1.000|F:0") is not None
    first = reader.read("Idle|WPos:1.000,1.000,1.000|FS:0,0|WCO:10.000,0.000,-5.000")
    assert first is not None
    assert first.position == (11.0, 1.0, -4.0)
    second = reader.read("Run|WPos:2.000,1.000,1.000|FS:0,0|Ov:100,100,100")
    assert second is not None
    assert second.position == (12.0, 1.0, -4.0)
    assert (second.offset, second.overrides) == ((10.0, 0.0, -5.0), (100, 100, 100))
    reader.forget()
    third = reader.read("Run|WPos:2.000,1.000,1.000")
    assert third is not None
    assert (third.position, third.offset, third.overrides) == (None, None, None)


def test_inches() -> None:
    reader = StatusReader()
    reader.unit = 25.4
    status = reader.read("Idle|MPos:1.0000,0.0000,-2.0000|F:10.0")
    assert status is not None
    assert status.position == pytest.approx((25.4, 0.0, -50.8))
    assert status.feed == pytest.approx(254.0)


@given(st.text(alphabet="IdleRun|MPosWCO:.,0123456789-FSBfOv<>", max_size=60))
def test_a_damaged_report_is_ignored(text: str) -> None:
    StatusReader().read(text)


@pytest.mark.parametrize(
    "text", ["", "Idle|MPos:1.0,x,0", "Idle|Ov:1,2", "12|MPos:0,0,0", "Idle|Bf:15"]
)
def test_damaged_reports(text: str) -> None:
    events = ready().receive(f"<{text}>\r\n".encode())
    assert not any(isinstance(event, Reported) for event in events)


def test_every_code_has_a_meaning_and_advice() -> None:
    # 18 and 19 are grblHAL's alone
    assert sorted(ERRORS[Firmware.GRBL]) == [*range(1, 18), *range(20, 39)]
    assert sorted(ALARMS[Firmware.GRBL]) == list(range(1, 11))
    for code in range(1, 93):
        for firmware in Firmware:
            assert all(error_meaning(code, firmware)), code
            assert all(alarm_meaning(code, firmware)), code


def test_grblhal_has_other_meanings_of_some_codes() -> None:
    assert "second limit switch" in alarm_meaning(10, Firmware.GRBL).fault
    assert "emergency stop" in alarm_meaning(10, Firmware.HAL).fault
    assert "second limit switch" in alarm_meaning(15, Firmware.HAL).fault
    assert ALARMS[Firmware.HAL][15].fault == ALARMS[Firmware.GRBL][10].fault


def test_fluidnc_has_other_meanings_of_some_codes() -> None:
    assert "control input" in alarm_meaning(11, Firmware.FLUID).fault
    assert "homed" in alarm_meaning(14, Firmware.FLUID).fault
    assert "no axis homes" in error_meaning(18, Firmware.FLUID).fault
    assert "password" in error_meaning(110, Firmware.FLUID).fault


def test_a_report_has_its_place_among_the_answers() -> None:
    """Answers that are read with it may be later: the lines waited when the board gave it."""
    protocol = ready()
    for number in range(3):
        protocol.send(single("G1 X1", number + 1))
    events = protocol.receive(b"ok\r\n<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\nok\r\nok\r\n")
    assert [event.waiting for event in events if isinstance(event, Reported)] == [2]
    assert protocol.waiting == 0

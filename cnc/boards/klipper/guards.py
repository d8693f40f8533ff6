"""What stops the motors of a Klipper board at once: switches, e-stop, probe, silence of the host.

One trigger (trsync) stops all motors. It is armed before each motion with the switches that are
watched, and with a timeout that is renewed while this computer lives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import BY_HOST, EXPIRED, InputObject, Layout
from cnc.boards.klipper.protocol import Message

SAMPLE_S, SAMPLES, REST_S = 10e-6, 4, 150e-6
"""Time between samples that confirm a closed switch, their number, and time between others.

A switch stops the motors within REST_S + SAMPLES * SAMPLE_S, 0.2 ms. The switches are sampled one
after the other, evenly spread over REST_S, so a step waits for one sample and not for all.
"""
TIMEOUT_S = 0.4
"""Time without a sign of this computer after which the motors stop."""
RENEW_S = 0.08
"""Time between two signs."""
REPORT_S = 0.1
"""Time between two reports of the trigger."""


@dataclass(frozen=True, slots=True)
class ArmedInput:
    """An input that ends a probing or homing move: the input, and the level that does so."""

    input: InputObject
    level: int


class TooLate(Exception):
    """A move whose time has come before it was sent: the board stops dead."""


@dataclass(frozen=True, slots=True)
class Guard:
    """What the sender asks of its owner.

    Attributes:
        pump: Sends, receives, and raises all faults.
        arm: Arms switches, timeout and motors, before a motion that begins at a clock.
        rest: Waits for the end of a motion, as the sender's own ``rest`` does, and disarms.
    """

    pump: Callable[[float], object]
    arm: Callable[[int], None]
    rest: Callable[[int], None]


class Guards:
    """The trigger of a board.

    Attributes:
        watched: Columns of the axes whose limit switches end the motion.
        armed: Inputs that end the next motion.
    """

    def __init__(self, connection: Connection, layout: Layout, axes: int) -> None:
        self._connection, self._layout = connection, layout
        self.watched = set(range(axes))
        self.armed: tuple[ArmedInput, ...] = ()
        self._renewed_at: float | None = None
        self._homing: list[InputObject] = []
        self._started = 0

    def arm(self, clock: int) -> None:
        """Arm everything before a motion that begins at a clock."""
        send, ticks = self._connection.send, self._connection.board_clock.frequency
        trigger = self._layout.trigger
        send(
            "trsync_start",
            oid=trigger,
            report_clock=clock % 2**32,
            report_ticks=round(REPORT_S * ticks),
            expire_reason=EXPIRED,
        )
        self._started = self._connection.link.appended
        for motor in self._layout.motors:
            send("stepper_stop_on_trigger", oid=motor.oid, trsync_oid=trigger)
            send("reset_step_clock", oid=motor.oid, clock=clock % 2**32)
        levels = self._levels()
        self._homing = list(levels)
        rest = round(REST_S * ticks)
        for k, switch in enumerate(levels):
            send(
                "endstop_home",
                oid=switch.oid,
                clock=(clock + k * rest // len(levels)) % 2**32,
                sample_ticks=round(SAMPLE_S * ticks),
                sample_count=SAMPLES,
                rest_ticks=rest,
                pin_value=levels[switch],
                trsync_oid=trigger,
                trigger_reason=switch.reason,
            )
        self._renewed_at = None
        self.renew()

    def _levels(self) -> dict[InputObject, int]:
        """Return the inputs that end the next motion, each with the level that does so."""
        armed = {watched_input.input: watched_input.level for watched_input in self.armed}
        return {
            switch: armed.get(switch, switch.active)
            for switch in self._layout.inputs
            if switch in armed
            or not (
                switch.name == "probe"
                or (switch.name == "limit" and switch.column not in self.watched)
            )
        }

    def renew(self) -> None:
        """Tell the board that this computer lives, if that is due."""
        now = self._connection.clock.now()
        if self._renewed_at is not None and now - self._renewed_at < RENEW_S:
            return
        self._renewed_at = now
        clock = self._connection.board_clock
        until = clock.at(now) + round(TIMEOUT_S * clock.frequency)
        self._connection.send("trsync_set_timeout", oid=self._layout.trigger, clock=until % 2**32)

    def disarm(self) -> None:
        """Stop to watch the switches."""
        for switch in self._homing:
            self._connection.send(
                "endstop_home",
                oid=switch.oid,
                clock=0,
                sample_ticks=0,
                sample_count=0,
                rest_ticks=0,
                pin_value=0,
                trsync_oid=self._layout.trigger,
                trigger_reason=0,
            )
        self._homing.clear()

    def is_trigger(self, message: Message) -> bool:
        """Return whether a message tells of a trigger since the last arming.

        The board repeats the report of a trigger until the watch ends or the next one begins.
        """
        return (
            message.name == "trsync_state"
            and message.acknowledged >= self._started
            and not message["can_trigger"]
        )

    def is_armed(self, reason: int) -> bool:
        """Return whether a trigger for this reason comes from an armed input."""
        return any(watched.input.reason == reason for watched in self.armed)

    def is_pressed(self, switch: InputObject, pump: Callable[[float], list[Message]]) -> bool:
        """Return whether an input is pressed."""
        ask = self._connection.ask
        state = ask("endstop_query_state", "endstop_state", pump, oid=switch.oid)
        return state["pin_value"] == switch.active

    def trigger(self) -> None:
        """Stop all motors at once."""
        self._connection.send("trsync_trigger", oid=self._layout.trigger, reason=BY_HOST)

    def end(self, pump: Callable[[float], list[Message]]) -> int:
        """End the watch of the motors, and return the reason of its trigger."""
        state = None
        # A report from before the command may come first.
        while state is None or not self.is_trigger(state):
            state = self._connection.ask(
                "trsync_trigger", "trsync_state", pump, oid=self._layout.trigger, reason=BY_HOST
            )
        return state["trigger_reason"]

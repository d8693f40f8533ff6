"""Commands of the simulated board (Klipper documentation, MCU commands)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from cnc.boards.klipper.protocol.dictionary import Message
from cnc.boards.klipper.simulator.devices import DriverModel, UartModel
from cnc.boards.klipper.simulator.outputs import Output
from cnc.boards.klipper.simulator.steppers import Motor
from cnc.boards.klipper.simulator.trsync import Switch, Trigger

if TYPE_CHECKING:
    from cnc.boards.klipper.simulator.klipper_simulator import KlipperSimulator

WRAP = 2**32
IN_SHUTDOWN = frozenset(
    (
        "identify",
        "get_config",
        "get_clock",
        "get_uptime",
        "emergency_stop",
        "clear_shutdown",
        "config_reset",
        "reset",
        "debug_ping",
    )
)
"""Commands that are carried out in a shutdown, too."""
Object = TypeVar("Object")


class Shutdown(Exception):
    """A command that shuts the board down, with its reason."""


class Commands:
    """Carries out the commands for a board."""

    def __init__(self, board: KlipperSimulator) -> None:
        self._board = board

    def carry_out(self, message: Message) -> bool:
        """Carry out a command; return whether the board goes on with those of the same block."""
        board = self._board
        if board.reason and message.name not in IN_SHUTDOWN:
            number = board.firmware.dictionary.number("static_string_id", board.reason) or 0
            board.respond("is_shutdown", static_string_id=number)
            return True
        action: Callable[[Message], None] = getattr(self, f"_{message.name}")
        try:
            action(message)
        except Shutdown as shutdown:
            board.shut_down(str(shutdown))
            return False
        return True

    def _identify(self, message: Message) -> None:
        offset = message["offset"]
        data = self._board.firmware.identify[offset : offset + message["count"]]
        self._board.respond("identify_response", offset=offset, data=data)

    def _get_config(self, message: Message) -> None:
        board = self._board
        board.respond(
            "config",
            is_config=int(board.finalized),
            crc=board.crc,
            is_shutdown=int(bool(board.reason)),
            move_count=board.firmware.slots if board.finalized else 0,
        )

    def _allocate_oids(self, message: Message) -> None:
        if self._board.oid_count:
            raise Shutdown("oids already allocated")
        self._board.oid_count = message["count"]

    def _finalize_config(self, message: Message) -> None:
        if self._board.finalized:
            raise Shutdown("Already finalized")
        self._board.finalized, self._board.crc = True, message["crc"]

    def _config_reset(self, message: Message) -> None:
        if not self._board.reason:
            raise Shutdown("config_reset only available when shutdown")
        board = self._board
        board.objects.clear()
        for each in (board.motors, board.outputs, board.switches, board.triggers):
            each.clear()
        board.oid_count = board.crc = 0
        board.finalized = False
        board.reason = ""

    def _reset(self, message: Message) -> None:
        self._board.reset()

    def _get_clock(self, message: Message) -> None:
        self._board.respond("clock", clock=self._board.clock % WRAP)

    def _get_uptime(self, message: Message) -> None:
        clock = self._board.clock
        self._board.respond("uptime", high=clock // WRAP % WRAP, clock=clock % WRAP)

    def _emergency_stop(self, message: Message) -> None:
        raise Shutdown("Command request")

    def _clear_shutdown(self, message: Message) -> None:
        self._board.reason = ""

    def _debug_ping(self, message: Message) -> None:
        self._board.respond("pong", data=message.data("data"))

    # Motors.

    def _config_stepper(self, message: Message) -> None:
        motor = Motor(
            message["oid"],
            self._output_pin(message["step_pin"]),
            self._output_pin(message["dir_pin"]),
            message["step_pulse_ticks"],
        )
        self._create(motor.oid, motor)
        self._board.motors.append(motor)
        self._board.positions[motor.step_pin] = 0

    def _queue_step(self, message: Message) -> None:
        board, motor = self._board, self._object(message["oid"], Motor)
        if not message["count"]:
            raise Shutdown("Invalid count parameter")
        if motor.needs_reset:
            return
        if reason := board.add_move(motor, message["interval"], message["count"], message["add"]):
            raise Shutdown(reason)

    def _set_next_step_dir(self, message: Message) -> None:
        self._object(message["oid"], Motor).set_direction(int(message["dir"] != 0))

    def _reset_step_clock(self, message: Message) -> None:
        motor = self._object(message["oid"], Motor)
        if motor.active:
            raise Shutdown("Can't reset time when stepper active")
        motor.reset(self._board.near(message["clock"]))
        self._board.look_again()

    def _stepper_get_position(self, message: Message) -> None:
        motor = self._object(message["oid"], Motor)
        self._board.respond("stepper_position", oid=motor.oid, pos=motor.position)

    def _stepper_stop_on_trigger(self, message: Message) -> None:
        motor = self._object(message["oid"], Motor)
        trigger = self._object(message["trsync_oid"], Trigger)
        if any(motor in each.motors for each in self._board.triggers):
            raise Shutdown("Can't add signal that is already active")
        trigger.motors.append(motor)

    # Triggers and switches.

    def _config_trsync(self, message: Message) -> None:
        trigger = Trigger(message["oid"])
        self._create(trigger.oid, trigger)
        self._board.triggers.append(trigger)

    def _trsync_start(self, message: Message) -> None:
        trigger = self._object(message["oid"], Trigger)
        trigger.motors.clear()
        trigger.can_trigger, trigger.reason = True, 0
        trigger.expire_reason = message["expire_reason"]
        trigger.report_ticks = message["report_ticks"]
        trigger.epoch += 1
        trigger.timeout_epoch += 1
        if trigger.report_ticks:
            clock = self._board.near(message["report_clock"])
            if clock < self._board.clock:
                raise Shutdown("Timer too close")
            self._report_at(trigger, clock, trigger.epoch)

    def _report_at(self, trigger: Trigger, clock: int, epoch: int) -> None:
        """Report at a clock and from then on, after a trigger too, until the watch is ended."""

        def report() -> None:
            if trigger.epoch == epoch:
                self._report(trigger, self._board.clock)
                self._report_at(trigger, clock + trigger.report_ticks, epoch)

        self._board.at(clock, report)

    def _report(self, trigger: Trigger, clock: int) -> None:
        self._board.respond(
            "trsync_state",
            oid=trigger.oid,
            can_trigger=int(trigger.can_trigger),
            trigger_reason=trigger.reason,
            clock=clock % WRAP,
        )

    def _trsync_set_timeout(self, message: Message) -> None:
        trigger = self._object(message["oid"], Trigger)
        if not trigger.can_trigger:
            return
        trigger.timeout_epoch += 1
        epoch = trigger.timeout_epoch
        clock = self._board.near(message["clock"])
        if clock < self._board.clock:
            raise Shutdown("Timer too close")

        def expire() -> None:
            if trigger.timeout_epoch == epoch:
                self._fire(trigger, trigger.expire_reason)

        self._board.at(clock, expire)

    def _trsync_trigger(self, message: Message) -> None:
        trigger = self._object(message["oid"], Trigger)
        self._stop(trigger, message["reason"])
        trigger.epoch += 1
        trigger.timeout_epoch += 1
        self._report(trigger, 0)

    def _fire(self, trigger: Trigger, reason: int) -> None:
        """Stop the motors for a reason that the board has seen itself, and report it."""
        if trigger.can_trigger:
            self._stop(trigger, reason)
            self._report(trigger, self._board.clock)

    def _stop(self, trigger: Trigger, reason: int) -> None:
        if not trigger.can_trigger:
            return
        board = self._board
        board.settle(board.clock)
        trigger.can_trigger, trigger.reason = False, reason
        for motor in trigger.motors:
            board.slots_used -= motor.stop()
        trigger.motors.clear()

    def _config_endstop(self, message: Message) -> None:
        switch = Switch(message["oid"], self._input_pin(message["pin"]), bool(message["pull_up"]))
        self._create(switch.oid, switch)
        self._board.switches.append(switch)

    def _endstop_home(self, message: Message) -> None:
        switch = self._object(message["oid"], Switch)
        if not message["sample_count"]:
            switch.armed = False
            switch.epoch += 1
            return
        switch.trigger = self._object(message["trsync_oid"], Trigger)
        switch.trigger_reason = message["trigger_reason"]
        clock = self._board.near(message["clock"])
        if clock < self._board.clock:
            raise Shutdown("Timer too close")
        times = message["sample_ticks"], message["sample_count"], message["rest_ticks"]
        switch.arm(clock, times, message["pin_value"])
        self.watch(switch)

    def watch(self, switch: Switch) -> None:
        """Plan the next sample of an armed switch, if its level can fire."""
        board = self._board
        level = board.levels.get(switch.pin, 1)
        if not callable(level) and level != switch.wanted:
            switch.left = switch.sample_count
            return
        switch.epoch += 1
        epoch, planned = switch.epoch, board.next_sample(switch)

        def sample() -> None:
            if switch.epoch != epoch or not switch.armed:
                return
            switch.skip_to(planned)
            if switch.sample(board.level(switch.pin)):
                if switch.trigger is not None:
                    self._fire(switch.trigger, switch.trigger_reason)
            else:
                self.watch(switch)

        board.at(planned, sample)

    def _endstop_query_state(self, message: Message) -> None:
        switch = self._object(message["oid"], Switch)
        self._board.respond(
            "endstop_state",
            oid=switch.oid,
            homing=int(switch.armed),
            next_clock=switch.next_clock % WRAP,
            pin_value=self._board.level(switch.pin),
        )

    # Outputs.

    def _config_digital_out(self, message: Message) -> None:
        self._create_output(message, pwm=False)

    def _config_pwm_out(self, message: Message) -> None:
        self._create_output(message, pwm=True)

    def _create_output(self, message: Message, *, pwm: bool) -> None:
        value = message["value"]
        output = Output(
            message["oid"],
            self._output_pin(message["pin"]),
            1 - value,
            message["default_value"],
            message["max_duration"],
            pwm,
        )
        self._create(output.oid, output)
        self._board.outputs.append(output)
        self._board.set_output(output, value)
        output.deadline = None

    def _set_digital_out_pwm_cycle(self, message: Message) -> None:
        self._object(message["oid"], Output).cycle_ticks = message["cycle_ticks"]

    def _set_digital_out(self, message: Message) -> None:
        pin = self._output_pin(message["pin"])
        self._board.history.append((self._board.clock, pin, message["value"]))

    def _update_digital_out(self, message: Message) -> None:
        self._board.set_output(self._object(message["oid"], Output), message["value"])

    def _queue_digital_out(self, message: Message) -> None:
        output, on = self._object(message["oid"], Output), message["on_ticks"]
        self._queue(output, message["clock"], on if output.cycle_ticks else int(on > 0))

    def _queue_pwm_out(self, message: Message) -> None:
        self._queue(self._object(message["oid"], Output), message["clock"], message["value"])

    def _queue(self, output: Output, clock32: int, value: int) -> None:
        board = self._board
        clock = board.near(clock32)
        if clock < board.clock:
            raise Shutdown("Timer too close")
        if output.is_late(clock):
            raise Shutdown(output.exceeded)
        if board.slots_used >= board.firmware.slots:
            raise Shutdown("Move queue overflow")
        board.slots_used += 1
        output.waiting.append((clock, value))

        def change() -> None:
            if not output.waiting or output.waiting[0] != (clock, value):
                return
            output.waiting.popleft()
            board.slots_used -= 1
            board.set_output(output, value)
            self._limit(output)

        board.at(clock, change)

    def _limit(self, output: Output) -> None:
        """Shut the board down where no update follows in time."""
        if output.deadline is None:
            return
        epoch, board = output.epoch, self._board

        def missed() -> None:
            if output.epoch == epoch and not board.reason:
                board.shut_down(output.missed)

        board.at(output.deadline, missed)

    # Motor drivers.

    def _config_tmcuart(self, message: Message) -> None:
        wire = self._board.uarts.setdefault(message["rx_pin"], UartModel())
        self._create(message["oid"], wire)

    def _tmcuart_send(self, message: Message) -> None:
        wire = self._object(message["oid"], UartModel)
        read = wire.send(message.data("write"), message["read"])
        self._board.respond("tmcuart_response", oid=message["oid"], read=read)

    def _config_spi(self, message: Message) -> None:
        device = self._board.spi.setdefault(message["pin"], DriverModel(powered=False))
        self._create(message["oid"], device)

    def _spi_set_bus(self, message: Message) -> None:
        self._object(message["oid"], DriverModel)

    def _spi_transfer(self, message: Message) -> None:
        answer = self._object(message["oid"], DriverModel).transfer(message.data("data"))
        self._board.respond("spi_transfer_response", oid=message["oid"], response=answer)

    def _spi_send(self, message: Message) -> None:
        self._object(message["oid"], DriverModel).transfer(message.data("data"))

    # Objects.

    def _create(self, oid: int, thing: object) -> None:
        board = self._board
        if oid >= board.oid_count or oid in board.objects or board.finalized:
            raise Shutdown("Can't assign oid")
        board.objects[oid] = thing

    def _object(self, oid: int, kind: type[Object]) -> Object:
        found = self._board.objects.get(oid)
        if not isinstance(found, kind):
            raise Shutdown("Invalid oid type")
        return found

    def _output_pin(self, pin: int) -> int:
        if pin not in self._board.firmware.dictionary.enumerations["pin"].values():
            raise Shutdown("Not an output pin")
        return pin

    def _input_pin(self, pin: int) -> int:
        if pin not in self._board.firmware.dictionary.enumerations["pin"].values():
            raise Shutdown("Not a valid input pin")
        return pin

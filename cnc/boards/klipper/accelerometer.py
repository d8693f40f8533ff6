"""An accelerometer (ADXL345) behind a Klipper board: its registers and its record.

The firmware reads the sensor's FIFO by itself, and sends samples in blocks:

    query_adxl345 ──► every rest_ticks the FIFO is read ──► sensor_bulk_data, ten samples each
    query_adxl345_status ──► sensor_bulk_status: clock, and the number of samples so far

The sensor has a clock of its own, up to some per cent off. So the rate of the samples is that of
two such numbers by the clock of the board.

Sources: ADXL345 data sheet; Klipper's documentation of bulk sensors and its messages.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from numpy.typing import NDArray

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.protocol import Message
from cnc.boards.protocols import Accelerations, board_error
from cnc.machine.klipper import Accelerometer
from cnc.model.diagnostics import BoardError

DEVID, BW_RATE, POWER_CTL, DATA_FORMAT, FIFO_CTL = 0x00, 0x2C, 0x2D, 0x31, 0x38
DEVICE, MEASURE, FULL_RANGE, STREAM = 0xE5, 0x08, 0x0B, 0x90
"""Identity; measuring; 13 bits for 16 g; a FIFO that keeps the newest samples."""
RATES = {400: 0x0C, 800: 0x0D, 1600: 0x0E, 3200: 0x0F}
"""Values of BW_RATE by samples per second."""
READ = 0x80
G = 9806.65
"""mm/s^2."""
SCALE = G / 256.0
"""mm/s^2 of a unit in the full range."""
SAMPLE, BLOCK = 5, 10
"""Bytes of a sample, and samples of a block."""
REST = 4.0
"""Samples between two looks into the FIFO, which holds 32."""
WRONG = 0x80
"""Bit in the last byte of a sample that was not read rightly."""
MOST_WRONG = 0.01
"""Part of such samples that a record may have: the one before stands for them."""


def raw_samples(data: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return samples (n, 3) in units of the sensor, from their bytes (n, 5).

    Bytes: the low 8 bits of x, y and z; then 3 bits of z and 5 of x; then 2 bits of z and 5 of y.
    """
    low, middle, high = data[:, :3].astype(np.int64), data[:, 3], data[:, 4]
    tops = np.stack(
        (middle & 0x1F, high & 0x1F, (middle >> 5) | ((high & 0x60) >> 2)), axis=1
    ).astype(np.int64)
    values = low | tops << 8
    return values - ((values & 0x1000) << 1)


class Adxl345:
    """The accelerometer of a board.

    Args:
        connection: The connection to the board.
        objects: Objects of its SPI device, and of itself.
        table: Its table in the machine file.
        pump: Exchanges bytes and returns the messages.

    Attributes:
        lock: Held while the connection is in use.
    """

    def __init__(
        self,
        connection: Connection,
        objects: tuple[int, int],
        table: Accelerometer,
        pump: Callable[[float], list[Message]],
    ) -> None:
        self._connection, self._pump = connection, pump
        self._spi, self._oid = objects
        self._table = table
        self._blocks: list[Message] | None = None
        self._stamps: list[tuple[int, int]] = []
        self.lock: AbstractContextManager[object] = nullcontext()
        connection.on_samples = self._take
        # One that records still has lost its program.
        self._query(0)

    def _take(self, message: Message) -> None:
        """Take a block of samples."""
        if self._blocks is not None and message["oid"] == self._oid:
            self._blocks.append(message)

    def begin(self) -> None:
        """Begin a record.

        Raises:
            BoardError: ``accelerometer-fault`` if the sensor does not answer.
        """
        with self.lock:
            if (device := self._read(DEVID)) != DEVICE:
                raise _fault(f"it answers {device:#04x} instead of {DEVICE:#04x}", WIRES)
            for register, value in (
                (POWER_CTL, 0),
                (DATA_FORMAT, FULL_RANGE),
                (FIFO_CTL, 0),
                (BW_RATE, RATES[self._table.rate]),
                (FIFO_CTL, STREAM),
            ):
                self._write(register, value)
            self._blocks = []
            self._query(round(REST / self._table.rate * self._connection.board_clock.frequency))
            self._write(POWER_CTL, MEASURE)
            self._stamps = [self._status()[:2]]

    def mark(self) -> None:
        """Note the number of the present sample."""
        with self.lock:
            self._stamps.append(self._status()[:2])

    def end(self) -> Accelerations:
        """End the record.

        Raises:
            BoardError: ``accelerometer-fault`` where samples were lost or wrong.
        """
        with self.lock:
            *last, overflows = self._status()
            self._write(POWER_CTL, 0)
            self._query(0)
            self._connection.flush(self._pump)
            blocks, self._blocks = self._blocks or [], None
        # The sensor needs some time after it was switched on, so the first mark counts.
        begin, *marks = self._stamps
        first = marks[0] if marks else begin
        seconds = (last[0] - first[0]) / self._connection.board_clock.rate
        samples = self._samples(blocks)
        if overflows:
            raise _fault("its FIFO has overflowed", SLOWER)
        if seconds <= 0.0 or not len(samples):
            raise _fault("it has sent nothing", WIRES)
        columns = {}
        for letter, name in zip("xyz", self._table.axes_map, strict=True):
            sign = -SCALE if name[0] == "-" else SCALE
            columns[letter] = sign * samples[:, "xyz".index(name[-1])]
        rate = (last[1] - first[1]) / seconds
        return Accelerations(rate, columns, tuple(number for _, number in marks))

    def _samples(self, blocks: list[Message]) -> NDArray[np.float64]:
        """Return the samples (n, 3) of blocks, which must follow each other."""
        for number, block in enumerate(blocks):
            if block["sequence"] != number & 0xFFFF:
                raise _fault("samples were lost on the cable", SLOWER)
        data = np.frombuffer(b"".join(block.data("data") for block in blocks), np.uint8)
        data = data.reshape(-1, SAMPLE)
        wrong = data[:, 4] & WRONG != 0
        if wrong.mean() > MOST_WRONG if len(wrong) else False:
            raise _fault(f"{100.0 * wrong.mean():.0f} % of its samples are not readable", WIRES)
        # The last right sample stands for a wrong one, so that the times stay right.
        last = np.maximum.accumulate(np.where(wrong, 0, np.arange(len(data))))
        return raw_samples(data[last]).astype(np.float64)

    def _status(self) -> tuple[int, int, int]:
        """Return a clock, the number of samples until then, and that of overflows."""
        connection = self._connection
        answer = self._ask("query_adxl345_status", "sensor_bulk_status", self._oid)
        clock = connection.board_clock.extend(answer["clock"], connection.clock.now())
        count = answer["next_sequence"] * BLOCK + answer["buffered"] // SAMPLE
        return clock + answer["query_ticks"] // 2, count, answer["possible_overflows"]

    def _query(self, rest_ticks: int) -> None:
        self._connection.send("query_adxl345", oid=self._oid, rest_ticks=rest_ticks)

    def _read(self, register: int) -> int:
        data = bytes((register | READ, 0))
        answer = self._ask("spi_transfer", "spi_transfer_response", self._spi, data=data)
        response = answer.data("response")
        return response[1] if len(response) == len(data) else -1

    def _write(self, register: int, value: int) -> None:
        self._connection.send("spi_send", oid=self._spi, data=bytes((register, value)))
        if (present := self._read(register)) != value:
            text = f"its register {register:#04x} has {present:#04x} instead of {value:#04x}"
            raise _fault(text, WIRES)

    def _ask(self, command: str, response: str, oid: int, **values: bytes) -> Message:
        return self._connection.ask(command, response, self._pump, oid=oid, **values)


WIRES = "check its wires, its supply, and the pins of board.klipper.accelerometer"
SLOWER = "check the cable, or set a lower rate in board.klipper.accelerometer"


def _fault(message: str, hint: str) -> BoardError:
    return board_error("accelerometer-fault", f"the accelerometer: {message}", hint=hint)

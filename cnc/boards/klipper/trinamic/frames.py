"""Datagrams of the drivers: UART (TMC2209 data sheet, chapter 4) and SPI (TMC5160 data sheet, 4).

      UART write   0xF5 | address | 0x80 + register | 4 bytes of data | CRC-8
           read    0xF5 | address | register | CRC-8
           answer  0x05 | 0xFF | register | 4 bytes of data | CRC-8
      SPI          0x80 + register or register | 4 bytes of data; the answer to a read comes with
                   the next datagram: status | 4 bytes of data

The board's firmware sends and receives the UART as bits: a start bit, 8 bits, a stop bit.
"""

from __future__ import annotations

SYNC, HOST, WRITE = 0x05, 0xFF, 0x80
CALL = 0xF0 | SYNC
"""First byte to a driver. It ignores the high bits. With them, Klipper's firmware times the sync
nibble, by which the driver measures the speed, and follows it: other interrupts may delay bits.
"""
ANSWER_BYTES = 8
"""Bytes of an answer of the UART."""
SPI_BYTES = 5


def crc8(data: bytes) -> int:
    """Return the CRC of a UART datagram: polynomial 0x07, the bits of each byte lowest first."""
    crc = 0
    for byte in data:
        for _ in range(8):
            crc = (crc << 1) ^ (0x07 if (crc >> 7) ^ (byte & 1) else 0) & 0xFF
            crc &= 0xFF
            byte >>= 1
    return crc


def uart_write(address: int, register: int, value: int) -> bytes:
    """Return the datagram that writes a register."""
    body = bytes((CALL, address, register | WRITE)) + value.to_bytes(4, "big")
    return body + bytes((crc8(body),))


def uart_read(address: int, register: int) -> bytes:
    """Return the datagram that asks for a register."""
    body = bytes((CALL, address, register))
    return body + bytes((crc8(body),))


def uart_answer(data: bytes, register: int) -> int | None:
    """Return the value in the answer for a register, None if it is no such answer."""
    right = len(data) == ANSWER_BYTES and data[:3] == bytes((SYNC, HOST, register))
    if not right or crc8(data[:-1]) != data[-1]:
        return None
    return int.from_bytes(data[3:7], "big")


def to_bits(data: bytes) -> bytes:
    """Return bytes with start and stop bits, packed from the lowest bit on; the rest is 1."""
    bits, size = 0, 0
    for byte in data:
        bits |= (byte << 1 | 0x200) << size
        size += 10
    total = -(-size // 8)
    bits |= (1 << 8 * total) - (1 << size)
    return bits.to_bytes(total, "little")


def from_bits(data: bytes) -> bytes | None:
    """Return the bytes between start and stop bits, None if these are wrong."""
    bits, found = int.from_bytes(data, "little"), bytearray()
    for k in range(len(data) * 8 // 10):
        part = bits >> 10 * k & 0x3FF
        if part & 1 or not part & 0x200:
            return None
        found.append(part >> 1 & 0xFF)
    return bytes(found)

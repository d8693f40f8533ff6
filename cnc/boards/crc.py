"""CRC-16 of the frames of stepper boards and Klipper boards."""

from __future__ import annotations

from binascii import crc_hqx

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def crc16(data: bytes) -> int:
    """Return CRC-16/MCRF4XX: polynomial 0x1021 reflected, initial value 0xFFFF.

    It is 0 over data followed by its CRC, low byte first.
    """
    straight = crc_hqx(data.translate(_REVERSED), 0xFFFF)
    return _REVERSED[straight >> 8] | _REVERSED[straight & 0xFF] << 8

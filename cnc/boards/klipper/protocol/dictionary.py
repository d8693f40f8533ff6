"""The data dictionary of a board: its commands, responses, enumerations and constants.

Klipper documentation, Protocol, "Data Dictionary". A board sends it as zlib-compressed JSON in
answers to ``identify``. Only ``identify`` and its response are known before.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from cnc.boards.klipper.protocol import vlq
from cnc.boards.klipper.protocol.errors import LocalError, RemoteError

IDENTIFY = "identify offset=%u count=%c"
IDENTIFY_RESPONSE = "identify_response offset=%u data=%.*s"
IDENTIFY_ID, IDENTIFY_RESPONSE_ID = 1, 0
RANGES = {
    "%u": (0, 2**32 - 1),
    "%i": (-(2**31), 2**31 - 1),
    "%hu": (0, 2**16 - 1),
    "%hi": (-(2**15), 2**15 - 1),
    "%c": (0, 255),
}
"""Range of each type of integer."""
BYTES = ("%s", "%.*s", "%*s")
_PARAMETER = re.compile(r"^([A-Za-z_]\w*)=(%\S+)$")

Value = int | bytes


@dataclass(frozen=True, slots=True)
class Message:
    """A message with its parameters.

    Attributes:
        name: Name of the message; "" for a message for people only.
        values: Value of each parameter by its name.
        acknowledged: Number of the last command that the board had taken when it sent the message.
    """

    name: str
    values: Mapping[str, Value]
    acknowledged: int = 0

    def __getitem__(self, name: str) -> int:
        """Return an integer of the message."""
        value = self.values[name]
        if not isinstance(value, int):
            raise RemoteError(f"{self.name} {name} is not a number")
        return value

    def data(self, name: str) -> bytes:
        """Return bytes of the message."""
        value = self.values[name]
        if not isinstance(value, bytes):
            raise RemoteError(f"{self.name} {name} is not a string")
        return value


@dataclass(frozen=True, slots=True)
class MessageFormat:
    """The format of a message, such as ``queue_step oid=%c interval=%u count=%hu add=%hi``.

    Attributes:
        number: Identifier of the message on the wire.
        name: First word of the format.
        parameters: Name and type of each parameter.
    """

    number: int
    name: str
    parameters: tuple[tuple[str, str], ...]
    head: bytes = field(repr=False, default=b"")

    @classmethod
    def parse(cls, text: str, number: int) -> MessageFormat:
        """Return the format of a text.

        Raises:
            RemoteError: It has a parameter of an unknown type.
        """
        words = text.split()
        if not words:
            raise RemoteError("a message of the dictionary has no name")
        parameters: list[tuple[str, str]] = []
        for word in words[1:]:
            match = _PARAMETER.match(word)
            if match is None or (match[2] not in RANGES and match[2] not in BYTES):
                raise RemoteError(f"the dictionary has the parameter {word!r} in {text!r}")
            parameters.append((match[1], match[2]))
        return cls(number, words[0], tuple(parameters), vlq.encode(number))

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Return the bytes of a message.

        Raises:
            LocalError: A parameter is missing, unknown, or outside the range of its type.
        """
        parts = [self.head]
        for name, kind in self.parameters:
            value = values.get(name)
            if value is None:
                raise LocalError(f"{self.name} needs the parameter {name}")
            if kind in BYTES:
                if not isinstance(value, bytes):
                    raise LocalError(f"{self.name} {name} must be bytes")
                parts += (vlq.encode(len(value)), value)
                continue
            if not isinstance(value, int):
                raise LocalError(f"{self.name} {name} must be an integer")
            least, most = RANGES[kind]
            if not least <= value <= most:
                raise LocalError(f"{self.name} {name}={value} is outside {least} to {most}")
            parts.append(vlq.encode(value))
        if len(values) > len(self.parameters):
            unknown = set(values) - {name for name, _ in self.parameters}
            raise LocalError(f"{self.name} has no parameter {', '.join(sorted(unknown))}")
        return b"".join(parts)

    def decode(self, data: bytes, at: int) -> tuple[Message, int]:
        """Return the message whose parameters begin at a byte, and the place after it.

        Raises:
            RemoteError: The bytes end too early.
        """
        values: dict[str, Value] = {}
        for name, kind in self.parameters:
            value, at = vlq.decode(data, at)
            if kind in BYTES:
                if value < 0 or at + value > len(data):
                    raise RemoteError(f"{self.name} {name} is longer than its message")
                values[name] = data[at : at + value]
                at += value
            else:
                values[name] = (vlq.signed if RANGES[kind][0] < 0 else vlq.unsigned)(value)
        return Message(self.name, values), at


class Dictionary:
    """The messages that a board understands and sends.

    Attributes:
        constants: Constants of the firmware, such as CLOCK_FREQ and MCU.
        enumerations: Number of each name, by the name of the enumeration.
        version: Version of the firmware.
    """

    def __init__(self, content: Mapping[str, Any] | None = None) -> None:
        known = content or {}
        try:
            commands = {IDENTIFY: IDENTIFY_ID, **known.get("commands", {})}
            responses = {IDENTIFY_RESPONSE: IDENTIFY_RESPONSE_ID, **known.get("responses", {})}
            self._commands = {each.name: each for each in _formats(commands)}
            self._by_number = {each.number: each for each in _formats(responses)}
            self._command_numbers = {each.number: each for each in self._commands.values()}
            self._outputs = {int(number) for number in known.get("output", {}).values()}
            self.constants: dict[str, Any] = dict(known.get("config", {}))
            self.enumerations = {
                str(name): dict(_members(members))
                for name, members in known.get("enumerations", {}).items()
            }
            self.version = str(known.get("version", ""))
        except (AttributeError, TypeError, ValueError) as error:
            raise RemoteError(f"the dictionary is malformed: {error}") from error

    @classmethod
    def of(cls, data: bytes) -> Dictionary:
        """Return the dictionary in the bytes that ``identify`` gives.

        Raises:
            RemoteError: They are not zlib-compressed JSON of a dictionary.
        """
        try:
            content = json.loads(zlib.decompress(data))
        except (zlib.error, ValueError, RecursionError) as error:
            raise RemoteError(f"the dictionary is not readable: {error}") from error
        if not isinstance(content, dict):
            raise RemoteError("the dictionary is not a table")
        return cls(content)

    @property
    def command_names(self) -> frozenset[str]:
        """Names of the commands."""
        return frozenset(self._commands)

    def parameters(self, command: str) -> frozenset[str]:
        """Return the names of the parameters of a command; empty for an unknown one."""
        known = self._commands.get(command)
        return frozenset(name for name, _ in known.parameters) if known else frozenset()

    def encode(self, command: str, **values: Value) -> bytes:
        """Return the bytes of a command.

        Raises:
            LocalError: The board does not know the command, or its parameters are wrong.
        """
        known = self._commands.get(command)
        if known is None:
            raise LocalError(f"the firmware of the board has no command {command}")
        return known.encode(values)

    def decode_responses(self, contents: bytes) -> Iterator[Message]:
        """Yield the messages in the contents of a block from the board.

        Raises:
            RemoteError: A message is unknown or too short.
        """
        yield from self._decode(contents, self._by_number)

    def decode_commands(self, contents: bytes) -> Iterator[Message]:
        """Yield the commands in the contents of a block from the host.

        Raises:
            RemoteError: A command is unknown or too short.
        """
        yield from self._decode(contents, self._command_numbers)

    def encode_response(self, name: str, **values: Value) -> bytes:
        """Return the bytes of a response, for a simulator.

        Raises:
            LocalError: There is no such response, or its parameters are wrong.
        """
        for each in self._by_number.values():
            if each.name == name:
                return each.encode(values)
        raise LocalError(f"there is no response {name}")

    def number(self, enumeration: str, name: str) -> int | None:
        """Return the number of a name in an enumeration, None if it has none."""
        return self.enumerations.get(enumeration, {}).get(name)

    def constant(self, name: str, default: float | None = None) -> float:
        """Return a constant that is a number.

        Raises:
            RemoteError: The firmware has no such number, and there is no default.
        """
        value = self.constants.get(name, default)
        try:
            if value is None:
                raise ValueError
            return float(value)
        except (TypeError, ValueError):
            raise RemoteError(f"the dictionary has no number {name}") from None

    def _decode(self, contents: bytes, formats: Mapping[int, MessageFormat]) -> Iterator[Message]:
        at = 0
        while at < len(contents):
            number, after = vlq.decode(contents, at)
            known = formats.get(number)
            if known is None:
                if number in self._outputs:
                    yield Message("", {"text": contents[after:]})
                    return
                raise RemoteError(f"the message {number} is not in the dictionary")
            message, at = known.decode(contents, after)
            yield message


def _formats(messages: Mapping[str, Any]) -> Iterator[MessageFormat]:
    for text, number in messages.items():
        yield MessageFormat.parse(text, int(number))


def _members(members: Mapping[str, Any]) -> Iterator[tuple[str, int]]:
    """Yield the names and numbers of an enumeration; ``"PA0": [0, 8]`` stands for eight."""
    for name, number in members.items():
        if isinstance(number, int):
            yield name, number
            continue
        first, count = (int(each) for each in number)
        stem = name.rstrip("0123456789")
        begin = int(name[len(stem) :] or 0)
        for k in range(count):
            yield f"{stem}{begin + k}", first + k

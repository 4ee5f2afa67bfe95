"""The protocol buffers' wire format, as far as one dataset's messages need it: decoded and encoded
by a table of fields, every field's wire type checked.

Source: the public encoding specification of protocol buffers (proto2): a field is a key (number
* 8 + wire type) and a value; wire types 0 varint, 1 eight bytes, 2 length-delimited, 5 four bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

Kind = Literal["double", "float", "int", "bool", "string", "message"]
_WIRE_TYPE: Final[Mapping[Kind, int]] = {
    "double": 1,
    "float": 5,
    "int": 0,
    "bool": 0,
    "string": 2,
    "message": 2,
}
_SIZE: Final = {1: 8, 5: 4}


class WireError(ValueError):
    """An error about bytes that are no such message; `path` names the field."""

    def __init__(self, problem: str, path: str) -> None:
        super().__init__(problem)
        self.path = path


@dataclass(frozen=True)
class Field:
    """name and kind; of a message, its fields by number; repeated fields decode to lists."""

    name: str
    kind: Kind
    fields: Mapping[int, Field] | None = None
    repeated: bool = False


Schema = Mapping[int, Field]


def decode(content: bytes, schema: Schema) -> dict[str, Any]:
    """The message as name -> value.  Absent fields are absent, unknown ones are passed over; of a
    field given twice the last holds, and messages given twice are merged, as proto2 has it.

    Raises WireError for bytes that are no such message.
    """
    message: dict[str, Any] = {}
    _decode_into(message, memoryview(content), schema, "")
    return message


def encode(message: Mapping[str, Any], schema: Schema) -> bytes:
    """The bytes of a message of this form, fields in order of their numbers."""
    parts = []
    for number, field in sorted(schema.items()):
        if field.name not in message:
            continue
        value = message[field.name]
        for item in value if field.repeated else [value]:
            parts.append(_varint(number << 3 | _WIRE_TYPE[field.kind]) + _encoded(item, field))
    return b"".join(parts)


def _decode_into(message: dict[str, Any], content: memoryview, schema: Schema, path: str) -> None:
    for number, wire_type, value in _fields(content, path):
        field = schema.get(number)
        if field is None:
            continue
        where = f"{path}{field.name}"
        if wire_type != _WIRE_TYPE[field.kind]:
            raise WireError(f"wire type {wire_type} where {_WIRE_TYPE[field.kind]} belongs", where)
        if field.kind == "message":
            assert field.fields is not None
            inner = {} if field.repeated else message.get(field.name, {})
            _decode_into(inner, value, field.fields, where + ".")
            decoded: Any = inner
        else:
            decoded = _scalar(value, field.kind, where)
        if field.repeated:
            message.setdefault(field.name, []).append(decoded)
        else:
            message[field.name] = decoded


def _fields(content: memoryview, path: str) -> Iterator[tuple[int, int, Any]]:
    """Number, wire type, and value: an integer for varints, else the bytes."""
    at = 0
    where = path.rstrip(".") or "message"
    while at < len(content):
        key, at = _read_varint(content, at, where)
        number, wire_type = key >> 3, key & 7
        if number == 0 or number >= 1 << 29:
            raise WireError(f"field number {number}", where)
        value: Any
        if wire_type == 0:
            value, at = _read_varint(content, at, where)
        elif wire_type in (1, 2, 5):
            size = _SIZE.get(wire_type)
            if size is None:
                size, at = _read_varint(content, at, where)
            if size > len(content) - at:
                raise WireError("cut short", where)
            value, at = content[at : at + size], at + size
        else:
            raise WireError(f"wire type {wire_type}", where)
        yield number, wire_type, value


def _read_varint(content: memoryview, at: int, where: str) -> tuple[int, int]:
    value = 0
    for place in range(10):
        if at >= len(content):
            raise WireError("cut short", where)
        byte = content[at]
        at += 1
        value |= (byte & 0x7F) << (7 * place)
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, at
    raise WireError("an integer of more than ten bytes", where)


def _scalar(value: Any, kind: Kind, where: str) -> Any:
    if kind == "double":
        return struct.unpack("<d", value)[0]
    if kind == "float":
        return struct.unpack("<f", value)[0]
    if kind == "string":
        try:
            return bytes(value).decode("utf-8")
        except UnicodeDecodeError:
            raise WireError("a text that is not UTF-8", where) from None
    if kind == "bool":
        return value != 0
    return value - (1 << 64) if value >= 1 << 63 else value


def _encoded(value: Any, field: Field) -> bytes:
    if field.kind == "double":
        return struct.pack("<d", value)
    if field.kind == "float":
        return struct.pack("<f", value)
    if field.kind in ("int", "bool"):
        return _varint(int(value) & 0xFFFFFFFFFFFFFFFF)
    if field.kind == "string":
        content = value.encode("utf-8")
    else:
        assert field.fields is not None
        content = encode(value, field.fields)
    return _varint(len(content)) + content


def _varint(value: int) -> bytes:
    groups: list[int] = []
    while True:
        groups.append(value & 0x7F | (0x80 if value > 0x7F else 0))
        value >>= 7
        if not value:
            return bytes(groups)


def numbered(**fields: tuple[int, Field | Kind]) -> dict[int, Field]:
    """A schema from name = (number, kind), or (number, Field) for messages and repeated fields."""
    schema = {}
    for name, (number, field) in fields.items():
        schema[number] = Field(name, field) if isinstance(field, str) else field
    return schema


def message(name: str, fields: Schema, *, repeated: bool = False) -> Field:
    """A field that holds a message."""
    return Field(name, "message", fields, repeated)


def repeated(name: str, kind: Kind) -> Field:
    """A field that may come any number of times."""
    return Field(name, kind, repeated=True)

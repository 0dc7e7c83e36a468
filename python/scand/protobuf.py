"""Decodes protobuf messages by the schema that a recording carries, without generated code."""

import struct

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
# Types of fields, as descriptor.proto numbers them.
_DOUBLE, _FLOAT, _STRING, _MESSAGE, _BYTES_TYPE = 1, 2, 9, 11, 12
_SIGNED = {3, 5, 14}
_FIXED = {6: "<Q", 7: "<I", 15: "<i", 16: "<q"}
_REPEATED = 3


def _varint(data, at):
    value, shift = 0, 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("a number of a message does not end")


def _fields(data):
    """The fields of a message: number, kind of wire, value."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        number, wire = key >> 3, key & 7
        if wire == _VARINT:
            value, at = _varint(data, at)
        elif wire in (_FIXED64, _FIXED32):
            size = 8 if wire == _FIXED64 else 4
            value, at = data[at : at + size], at + size
        elif wire == _BYTES:
            size, at = _varint(data, at)
            value, at = data[at : at + size], at + size
            if len(value) != size:
                raise ValueError("a message is cut off")
        else:
            raise ValueError(f"a message has the wire type {wire}")
        yield number, wire, value


class Schema:
    """The message types of a FileDescriptorSet."""

    def __init__(self, descriptors):
        self._types = {}
        for number, _, file in _fields(descriptors):
            if number == 1:
                fields = list(_fields(file))
                package = next((v.decode() for n, _, v in fields if n == 2), "")
                for n, _, message in fields:
                    if n == 4:
                        self._add(package, message)

    def _add(self, scope, message):
        fields = list(_fields(message))
        name = f"{scope}." + next(v.decode() for n, _, v in fields if n == 1)
        known = {}
        for n, _, value in fields:
            if n == 2:
                parts = {number: v for number, _, v in _fields(value)}
                known[parts[3]] = (
                    parts[1].decode(),
                    parts.get(5, 0),
                    parts.get(6, b"").decode().lstrip("."),
                    parts.get(4) == _REPEATED,
                )
            elif n == 3:
                self._add(name, value)
        self._types[name.lstrip(".")] = known

    def decode(self, name, data):
        """A message as a dictionary. Fields that are not there are left out, or empty lists."""
        known = self._types[name]
        message = {field: [] for field, _, _, repeated in known.values() if repeated}
        for number, wire, value in _fields(data):
            if number not in known:
                continue
            field, kind, type_name, repeated = known[number]
            if repeated and wire == _BYTES and kind not in (_STRING, _MESSAGE, _BYTES_TYPE):
                message[field].extend(_packed(kind, value))
                continue
            decoded = self._value(kind, type_name, value)
            if repeated:
                message[field].append(decoded)
            else:
                message[field] = decoded
        return message

    def _value(self, kind, type_name, value):
        if kind == _MESSAGE:
            return self.decode(type_name, value)
        if kind == _STRING:
            return bytes(value).decode()
        if kind == _BYTES_TYPE:
            return value
        return _number(kind, value)


def _number(kind, value):
    if kind == _DOUBLE:
        return struct.unpack("<d", value)[0]
    if kind == _FLOAT:
        return struct.unpack("<f", value)[0]
    if kind in _FIXED:
        return struct.unpack(_FIXED[kind], value)[0]
    if kind in _SIGNED and value >= 1 << 63:
        return value - (1 << 64)
    return value


def _packed(kind, data):
    formats = {_DOUBLE: "<d", _FLOAT: "<f", **_FIXED}
    if kind in formats:
        return [value for (value,) in struct.iter_unpack(formats[kind], data)]
    values, at = [], 0
    while at < len(data):
        value, at = _varint(data, at)
        values.append(_number(kind, value))
    return values

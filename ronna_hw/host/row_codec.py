"""Codec of rows: classes of named fields as packed little-endian structs.

A row is a `NamedTuple` or a dataclass. Each field is packed by the struct code of its annotation, or as its
type says: floats, other rows, a row or None, at most so many rows::

    class Sample(NamedTuple):
        number: Annotated[int, "Q"]
        phase: Annotated[Phase, "B"]
        joints_rad: JointVector
        side: Annotated[str, one_of(("left", "right"))]
        target: Pose | None
        steps: Annotated[tuple[Step, ...], 12]

Struct, pack and unpack follow from it. They are compiled once, as `NamedTuple` compiles itself, so that a
control cycle pays for nothing but the packing; it goes without NumPy, whose rows take three times as long.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, is_dataclass
from enum import Enum
from socket import inet_aton, inet_ntoa
from types import NoneType
from typing import Annotated, Any, Generic, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

ANY_HOST = "0.0.0.0"
TEXT_PADDING = b"\0"
RowT = TypeVar("RowT")


class FieldCode(NamedTuple):
    """Struct code with conversions for non-numeric values."""

    code: str
    encode: Callable[[Any], Any] | None = None
    decode: Callable[[Any], Any] | None = None


def one_of(choices: Sequence[Any]) -> FieldCode:
    """Build a field for one of these values, stored as its index in one byte."""
    return FieldCode("B", choices.index, choices.__getitem__)


def text(capacity_bytes: int) -> FieldCode:
    """Build a field for a short UTF-8 string; longer text is truncated."""

    def encode(value: str) -> bytes:
        return value.encode()[:capacity_bytes]

    def decode(value: bytes) -> str:
        return value.rstrip(TEXT_PADDING).decode(errors="ignore")

    return FieldCode(f"{capacity_bytes}s", encode, decode)


IPV4_HOST = FieldCode(  # "" for none
    "4s", lambda host: inet_aton(host or ANY_HOST), lambda packed: inet_ntoa(packed) if any(packed) else ""
)


class RowCodec(Generic[RowT]):
    """Codec of one class of rows."""

    def __init__(self, row: type[RowT], open_length: int | None = None) -> None:
        """Prepare the codec; raises TypeError for a field without a struct code.

        `open_length` is the number of floats in a `tuple[float, ...]`.
        """
        compiler = _Compiler(open_length)
        field = compiler.row(row)
        layout = struct.Struct(f"<{field.code}")
        self.size_bytes = layout.size
        self.pack: Callable[[RowT], bytes] = compiler.pack(field, layout.pack)
        self._make: Callable[[tuple[Any, ...]], RowT] = compiler.unpack(field)
        self._unpack, self._unpack_from = layout.unpack, layout.unpack_from

    def unpack(self, data: bytes) -> RowT:
        """Decode a row produced by `pack`; raises struct.error if the length is wrong."""
        return self._make(self._unpack(data))

    def unpack_from(self, memory: Any, offset: int) -> RowT:
        """Decode the row at an offset in memory."""
        return self._make(self._unpack_from(memory, offset))


@dataclass(frozen=True)
class _Field:
    """Packed form of a value: struct code and count of its numbers, and expressions of both directions."""

    code: str
    count: int
    packed: Callable[[str], str]  # of the value's expression: its numbers, separated by commas
    unpacked: Callable[[int], str]  # of the index in the tuple `v` where its numbers begin: the value


class _Compiler:
    """Compiler of one codec, whose expressions share their names."""

    def __init__(self, open_length: int | None) -> None:
        self._names: dict[str, Any] = {}
        self._open_length = open_length

    def pack(self, field: _Field, finish: Callable[..., Any]) -> Callable[[Any], Any]:
        """Compile what calls `finish` with the numbers of a value."""
        packed: Callable[[Any], Any] = eval(
            f"lambda value: {self._name(finish)}({field.packed('value')})", self._names
        )
        return packed

    def unpack(self, field: _Field) -> Callable[[tuple[Any, ...]], Any]:
        """Compile what makes a value of its numbers."""
        unpacked: Callable[[tuple[Any, ...]], Any] = eval(f"lambda v: {field.unpacked(0)}", self._names)
        return unpacked

    def row(self, row: type) -> _Field:
        """Return the packed form of a row."""
        is_tuple = issubclass(row, tuple)
        fields: list[_Field] = []
        values, places, count = [], [], 0
        for index, (name, hint) in enumerate(get_type_hints(row, include_extras=True).items()):
            fields.append(field := self._field(hint, f"{row.__name__}.{name}"))
            values.append(f"[{index}]" if is_tuple else f".{name}")
            places.append(count)
            count += field.count
        made = self._name(row)
        return _Field(
            "".join(field.code for field in fields),
            count,
            lambda value: ", ".join(
                field.packed(value + own) for field, own in zip(fields, values, strict=True)
            ),
            lambda at: (
                f"{made}({', '.join(f.unpacked(at + own) for f, own in zip(fields, places, strict=True))})"
            ),
        )

    def _field(self, hint: Any, where: str) -> _Field:
        kind, note = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
        if isinstance(note, int):
            return self._at_most(note, self._field(get_args(kind)[0], where))
        if note is not None:
            return self._coded(kind, note if isinstance(note, FieldCode) else FieldCode(note))
        if isinstance(kind, type) and (is_dataclass(kind) or hasattr(kind, "_fields")):
            return self.row(kind)
        parts = get_args(kind)
        if NoneType in parts:
            return self._optional(self._field(next(one for one in parts if one is not NoneType), where))
        if parts == (float, Ellipsis) and self._open_length is not None:
            return self._coded(kind, FieldCode(f"{self._open_length}d"))
        if kind is float or (parts and set(parts) == {float}):
            return self._coded(kind, FieldCode(f"{max(len(parts), 1)}d"))
        if kind is bool:
            return self._coded(kind, FieldCode("?"))
        raise TypeError(f"{where} has no struct code")

    def _coded(self, kind: Any, code: FieldCode) -> _Field:
        count = len(_zeros(code.code))
        decode = kind if isinstance(kind, type) and issubclass(kind, Enum) else code.decode
        encoded = self._name(code.encode) if code.encode else ""
        decoded = self._name(decode) if decode else ""
        star = "*" if count > 1 else ""
        return _Field(
            code.code,
            count,
            lambda value: f"{star}{encoded}({value})" if encoded else star + value,
            lambda at: f"{decoded}(v[{at}:{at + count}])" if star else f"{decoded}(v[{at}])",
        )

    def _optional(self, inner: _Field) -> _Field:
        """Return the packed form of a value or None, which begins with whether there is one."""
        numbers, nothing = self.pack(inner, _as_tuple), (False, *_zeros(inner.code))
        pack = self._name(lambda value: nothing if value is None else (True, *numbers(value)))
        return _Field(
            f"?{inner.code}",
            1 + inner.count,
            lambda value: f"*{pack}({value})",
            lambda at: f"({inner.unpacked(at + 1)} if v[{at}] else None)",
        )

    def _at_most(self, most: int, inner: _Field) -> _Field:
        """Return the packed form of a tuple of values, which begins with how many they are."""
        numbers, zeros = self.pack(inner, _as_tuple), _zeros(inner.code)

        def pack(values: tuple[Any, ...]) -> tuple[Any, ...]:
            used = [number for value in values for number in numbers(value)]
            return (len(values), *used, *zeros * (most - len(values)))

        packed, make = self._name(pack), self._name(self.unpack(inner))
        size = inner.count
        return _Field(
            f"B{inner.code * most}",
            1 + size * most,
            lambda value: f"*{packed}({value})",
            lambda at: (
                f"tuple({make}(v[k : k + {size}]) "
                f"for k in range({at + 1}, {at + 1} + {size} * v[{at}], {size}))"
            ),
        )

    def _name(self, thing: Any) -> str:
        name = f"x{len(self._names)}"
        self._names[name] = thing
        return name


def _zeros(code: str) -> tuple[Any, ...]:
    layout = struct.Struct(f"<{code}")
    return layout.unpack(bytes(layout.size))


def _as_tuple(*numbers: Any) -> tuple[Any, ...]:
    return numbers

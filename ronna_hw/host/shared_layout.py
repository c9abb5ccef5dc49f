"""One table per block of shared memory: a `NamedTuple` whose annotations carry the struct code of each field.

    class Sample(NamedTuple):
        number: Annotated[int, "Q"]
        phase: Annotated[Phase, "B"]
        joints_rad: Annotated[JointVector, "6d"]
        side: Annotated[str, one_of(("left", "right"))]

Struct, pack and unpack follow from it. They are compiled once, as `NamedTuple` compiles itself, so that a
control cycle pays for nothing but the packing.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from enum import Enum
from socket import inet_aton, inet_ntoa
from typing import Annotated, Any, Generic, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

ANY_HOST = "0.0.0.0"
TEXT_PADDING = b"\0"

RowT = TypeVar("RowT", bound=tuple[Any, ...])


class FieldCode(NamedTuple):
    """A struct code, with conversions for a value that is not a number."""

    code: str
    encode: Callable[[Any], Any] | None = None
    decode: Callable[[Any], Any] | None = None


def one_of(choices: Sequence[str]) -> FieldCode:
    """One of a few words, stored as its index in a byte."""
    return FieldCode("B", choices.index, choices.__getitem__)


def text(capacity_bytes: int) -> FieldCode:
    """A short text in UTF-8; anything longer is cut off."""

    def encode(value: str) -> bytes:
        return value.encode()[:capacity_bytes]

    def decode(value: bytes) -> str:
        return value.rstrip(TEXT_PADDING).decode(errors="ignore")

    return FieldCode(f"{capacity_bytes}s", encode, decode)


def _host_to_bytes(host: str) -> bytes:
    return inet_aton(host or ANY_HOST)


def _host_of_bytes(packed: bytes) -> str:
    return inet_ntoa(packed) if any(packed) else ""


IPV4_HOST = FieldCode("4s", _host_to_bytes, _host_of_bytes)  # "" for none


class RowCodec(Generic[RowT]):
    """Struct, pack and unpack of one `NamedTuple` class, little endian and without padding."""

    def __init__(self, row: type[RowT]) -> None:
        """Raises TypeError for a field without a struct code."""
        namespace: dict[str, Any] = {"row_type": row}
        codes, packed, unpacked = ["<"], [], []
        at = 0
        for index, (name, hint) in enumerate(get_type_hints(row, include_extras=True).items()):
            field = _field_code(row, name, hint, namespace)
            count = len(struct.unpack(f"<{field.code}", bytes(struct.calcsize(f"<{field.code}"))))
            codes.append(field.code)
            value = f"row[{index}]"
            if field.encode is not None:
                namespace[f"encode_{name}"] = field.encode
                value = f"encode_{name}({value})"
            packed.append(value if count == 1 else f"*{value}")
            value = f"v[{at}]" if count == 1 else f"v[{at}:{at + count}]"
            if field.decode is not None:
                namespace[f"decode_{name}"] = field.decode
                value = f"decode_{name}({value})"
            unpacked.append(value)
            at += count
        layout = struct.Struct("".join(codes))
        namespace["pack_values"] = layout.pack
        self.size_bytes = layout.size
        self.pack: Callable[[RowT], bytes] = eval(f"lambda row: pack_values({', '.join(packed)})", namespace)
        self._make: Callable[[tuple[Any, ...]], RowT] = eval(
            f"lambda v: row_type({', '.join(unpacked)})", namespace
        )
        self._unpack, self._unpack_from = layout.unpack, layout.unpack_from

    def unpack(self, data: bytes) -> RowT:
        """The row made by `pack`; raises struct.error for another length."""
        return self._make(self._unpack(data))

    def unpack_from(self, memory: Any, offset: int) -> RowT:
        """The row at an offset in memory."""
        return self._make(self._unpack_from(memory, offset))


def _field_code(row: type, name: str, hint: Any, namespace: dict[str, Any]) -> FieldCode:
    if get_origin(hint) is not Annotated:
        raise TypeError(f"{row.__name__}.{name} has no struct code")
    kind, code = get_args(hint)[:2]
    field = code if isinstance(code, FieldCode) else FieldCode(code)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return field._replace(decode=kind)
    return field

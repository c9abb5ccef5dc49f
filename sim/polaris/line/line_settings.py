"""The settings of a serial line: rate, bits, parity, stop bits, handshake (COMM)."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.wire import polaris as wire


@dataclass(frozen=True)
class LineSettings:
    """Settings of a serial line; a TCP connection ignores them."""

    baud: int
    data_bits: int = 8
    parity: str = "none"
    stop_bits: int = 1
    handshake: str = "off"

    @classmethod
    def from_argument(cls, argument: str) -> LineSettings:
        """Settings from the argument of COMM; raises KeyError for an unknown code."""
        baud, data, parity, stop, handshake = tuple(argument)
        return cls(
            wire.COMM_BAUD_CODES[baud],
            wire.COMM_DATA_BITS[data],
            wire.COMM_PARITY[parity],
            wire.COMM_STOP_BITS[stop],
            wire.COMM_HANDSHAKE[handshake],
        )

    @property
    def seconds_per_byte(self) -> float:
        """Transfer time of one byte: start bit, data, parity, stop bits."""
        return (1 + self.data_bits + (self.parity != "none") + self.stop_bits) / self.baud


DEFAULT_LINE = LineSettings.from_argument(wire.COMM_DEFAULT_ARGUMENT)

"""The settings of a serial line: rate, bits, parity, stop bits, handshake (COMM)."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.wire import polaris as wire


@dataclass(frozen=True)
class LineSettings:
    """How bytes travel. A TCP connection has none of this and ignores it."""

    baud: int
    data_bits: int = 8
    parity: str = "none"
    stop_bits: int = 1
    handshake: str = "off"

    @classmethod
    def from_argument(cls, argument: str) -> LineSettings:
        """The settings that an argument of COMM asks for; raises KeyError for a code that does not exist."""
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
        """Time on the line of one byte: start bit, data, parity, stop bits."""
        return (1 + self.data_bits + (self.parity != "none") + self.stop_bits) / self.baud


DEFAULT_LINE = LineSettings.from_argument(wire.COMM_DEFAULT_ARGUMENT)

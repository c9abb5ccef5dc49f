"""A transport that passes its bytes to a recorder."""

from __future__ import annotations

from drivers.ndi_polaris.line.transport import Transport
from ronna_hw.devices.capabilities import ByteSink, Direction


class RecordedTransport:
    """Wraps a transport and reports its traffic."""

    def __init__(self, transport: Transport, link: str, sink: ByteSink) -> None:
        self._transport = transport
        self._link = link
        self._sink = sink

    @property
    def baud(self) -> int | None:
        return self._transport.baud

    def write(self, data: bytes) -> None:
        self._transport.write(data)
        self._sink.passed(self._link, Direction.SENT, data)

    def read(self, timeout_s: float) -> bytes:
        data = self._transport.read(timeout_s)
        if data:
            self._sink.passed(self._link, Direction.RECEIVED, data)
        return data

    def set_baud(self, baud: int) -> None:
        self._transport.set_baud(baud)
        if self.baud is not None:
            self._sink.note(self._link, baud=baud)

    def send_break(self) -> None:
        self._transport.send_break()
        self._sink.note(self._link, sent="break")

    def close(self) -> None:
        self._transport.close()

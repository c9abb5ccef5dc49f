"""The bytes of the arm's two links, for recording: the EKI connection and the RSI telegrams."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from drivers.kuka_rsi.realtime.mailbox import KeptCycle
from ronna_hw.devices.capabilities import ByteSink, Direction, Passed

BytesPassed = Callable[[Direction, bytes], None]


class LinkBytes:
    """The recorder's sinks, if any; queried when a link is opened."""

    def __init__(self, arm: str) -> None:
        self._arm = arm
        self.sink: ByteSink | None = None

    @property
    def of_eki(self) -> BytesPassed | None:
        """Receives the bytes of the EKI connection; None without a recorder."""
        sink, link = self.sink, f"{self._arm}.eki"
        if sink is None:
            return None
        return lambda direction, data: sink.passed(link, direction, data)

    @property
    def of_rsi(self) -> Callable[[list[KeptCycle], int], None] | None:
        """Receives the telegrams and replies kept by the real-time process."""
        sink, link = self.sink, f"{self._arm}.rsi"
        if sink is None:
            return None

        def take(cycles: list[KeptCycle], lost: int) -> None:
            sink.passed_earlier(link, list(_both_ways(cycles)))
            if lost:
                sink.note(link, lost_bytes=lost)

        return take


def _both_ways(cycles: list[KeptCycle]) -> Iterator[Passed]:
    for cycle in cycles:
        yield Passed(cycle.received_ns, Direction.RECEIVED, cycle.telegram)
        if cycle.reply:
            yield Passed(cycle.sent_ns, Direction.SENT, cycle.reply)

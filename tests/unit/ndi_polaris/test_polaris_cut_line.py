"""A line that ends after any byte of a bring-up, or is never quiet: an error with a code, in time."""

from __future__ import annotations

import tracemalloc

import pytest
from polaris_unit_in_process import Deliveries, StillClock, UnitInProcess, bring_up, tracker_on

from drivers.ndi_polaris.command_link import CommandLink
from drivers.ndi_polaris.discovery import RESET_LIMIT_S, await_reset
from ronna_hw.errors import RonnaError

BRINGS_UP_S = 30.0  # three calls with their usual limits
CLOSES_IN_S = 2.0
FLOOD_BYTES = 22_000_000


class CutLine(UnitInProcess):
    """Ends after so many bytes from the unit: at once where it is `hung_up`, or by silence."""

    def __init__(self, left: int, *, hung_up: bool) -> None:
        super().__init__(baud=None)
        self.left = left
        self._hung_up = hung_up
        self.deliver = self._cut

    def _cut(self, _command: str, reply: bytes) -> Deliveries:
        passed, self.left = reply[: self.left], max(0, self.left - len(reply))
        return [(0.001, passed)] if passed else []

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        self.closed = self._hung_up and not self.left and not data
        return data


@pytest.mark.parametrize("hung_up", [True, False])
def test_a_line_that_ends_after_any_byte_of_a_bring_up_is_an_error_with_a_code(hung_up: bool) -> None:
    endless = 1 << 30
    whole = CutLine(endless, hung_up=hung_up)
    bring_up(tracker_on(whole, StillClock(), "tcp://127.0.0.1:8765"))
    codes = set()
    for count in range(endless - whole.left):
        unit = CutLine(count, hung_up=hung_up)
        device = tracker_on(unit, StillClock(), "tcp://127.0.0.1:8765")
        with pytest.raises(RonnaError) as raised:
            bring_up(device)
        assert unit.now_s < BRINGS_UP_S, f"after byte {count}"
        codes.add(raised.value.code)
        began_s = unit.now_s
        device.close()
        assert unit.now_s - began_s < CLOSES_IN_S, f"after byte {count}"
    assert all(code.startswith("NDI-") for code in codes)
    assert len(codes) > 1


def test_a_line_that_is_never_quiet_costs_no_memory_while_a_reset_is_awaited() -> None:
    class Flood(UnitInProcess):
        heard = 0

        def read(self, timeout_s: float) -> bytes:
            self.heard += 65536
            self.now_s += min(timeout_s, RESET_LIMIT_S * 65536 / FLOOD_BYTES)
            return b"A" * 65536

    unit = Flood()
    link = CommandLink(unit, monotonic=lambda: unit.now_s)
    tracemalloc.start()
    try:
        assert not await_reset(link, 2 * RESET_LIMIT_S)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert unit.heard >= FLOOD_BYTES
    assert most < 1_000_000

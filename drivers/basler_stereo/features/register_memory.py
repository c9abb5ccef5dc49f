"""A camera's registers as the memory addressed by its GenICam description."""

from __future__ import annotations

from drivers.basler_stereo.control.channel import ControlChannel
from ronna_hw.wire.gige_vision import REGISTER_BYTES


class RegisterMemory:
    """Reads and writes through the control channel until `deadline_s`, which each operation sets."""

    def __init__(self, control: ControlChannel) -> None:
        self._control = control
        self.deadline_s = 0.0

    def read(self, address: int, count: int) -> bytes:
        """`count` bytes, a multiple of 4; raises GEV-006, GEV-007, GEV-008."""
        if count == REGISTER_BYTES:
            return self._control.read_register(address, self.deadline_s).to_bytes(REGISTER_BYTES, "big")
        return self._control.read_memory(address, count, self.deadline_s)

    def write(self, address: int, data: bytes) -> None:
        """A multiple of 4 bytes; raises GEV-006, GEV-007."""
        if len(data) == REGISTER_BYTES:
            self._control.write_register(address, int.from_bytes(data, "big"), self.deadline_s)
        else:
            self._control.write_memory(address, data, self.deadline_s)

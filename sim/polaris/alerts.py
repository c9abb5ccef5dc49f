"""The unit's alerts: what is wrong now, and what of it the host has not read yet."""

from __future__ import annotations

from ronna_hw.wire.polaris import Alert, SystemStatus

HARDWARE = (
    Alert.FATAL_PARAMETER
    | Alert.SENSOR_PARAMETER
    | Alert.MAIN_VOLTAGE
    | Alert.SENSOR_VOLTAGE
    | Alert.ILLUMINATOR_VOLTAGE
    | Alert.ILLUMINATOR_CURRENT
    | Alert.LEFT_SENSOR_TEMPERATURE
    | Alert.RIGHT_SENSOR_TEMPERATURE
    | Alert.MAIN_BOARD_TEMPERATURE
)
TEMPERATURE = Alert.TOO_HOT | Alert.TOO_COLD


class Alerts:
    """Alert bits. Reading the new ones clears them."""

    def __init__(self) -> None:
        self.current = Alert(0)
        self._new = Alert(0)

    def set(self, bits: int) -> None:
        """Make these bits the present alerts; what was not set before is new."""
        raised = Alert(bits & sum(Alert))
        self._new |= raised & ~self.current
        self.current = raised

    def clear_bump(self) -> None:
        """The host has looked after the bump."""
        self.current &= ~Alert.BUMP
        self._new &= ~Alert.BUMP

    def read_new(self) -> int:
        """The alerts that have not been read before."""
        new = int(self._new)
        self._new = Alert(0)
        return new

    @property
    def system_status(self) -> SystemStatus:
        """What the alerts add to the system status of TX and BX."""
        status = SystemStatus(0)
        if self._new:
            status |= SystemStatus.DIAGNOSTICS_PENDING
        if self.current & HARDWARE:
            status |= SystemStatus.HARDWARE_FAILURE
        if self.current & TEMPERATURE:
            status |= SystemStatus.TEMPERATURE
        return status

"""Alerts: what is wrong now, and what the host has not read yet."""

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
_ALL = int(sum(Alert))


class Alerts:
    """Alert bits from three sources: simulated by the host, lasting, and a bump that stays until cleared.

    Reading new ones clears them.
    """

    def __init__(self) -> None:
        self.detects_bumps = True
        self.system_status = SystemStatus(0)  # bits of the system status of TX and BX that alerts set
        self.current = Alert(0)
        self._new = Alert(0)
        self._simulated = Alert(0)
        self._lasting = Alert(0)
        self._raised = Alert(0)

    def reset(self) -> None:
        """Power-up: clear bump and simulated alerts; lasting ones are detected again."""
        self._simulated = self._raised = self._new = self.current = Alert(0)
        self._update()

    def simulate(self, bits: int) -> None:
        """Set the alerts that the host simulates (`Param.Simulated Alerts`)."""
        self._simulated = Alert(bits & _ALL)
        self._update()

    def impose(self, bits: int) -> None:
        """Set the unit's actual problems."""
        self._lasting = Alert(bits & _ALL)
        self._update()

    def raise_alert(self, alert: Alert) -> None:
        """Raise a bump, if detection is on; it stays until the host clears it."""
        if alert is Alert.BUMP and not self.detects_bumps:
            return
        self._new |= alert  # a second bump is also a new alert
        self._raised |= alert
        self._update()

    def clear_bump(self) -> None:
        """The host has cleared the bump."""
        self._raised &= ~Alert.BUMP
        self._simulated &= ~Alert.BUMP
        self._new &= ~Alert.BUMP
        self._update()

    def read_new(self) -> int:
        """Alerts not read before; reading clears them."""
        new = int(self._new)
        self._new = Alert(0)
        self._update()
        return new

    def _update(self) -> None:
        current = self._simulated | self._lasting | self._raised
        self._new |= current & ~self.current
        self.current = current
        status = SystemStatus(0)
        if self._new:
            status |= SystemStatus.DIAGNOSTICS_PENDING
        if current & HARDWARE:
            status |= SystemStatus.HARDWARE_FAILURE
        if current & TEMPERATURE:
            status |= SystemStatus.TEMPERATURE
        self.system_status = status

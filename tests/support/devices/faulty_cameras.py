"""Simulated cameras as a process, faults for them, and drivers connected to them."""

from __future__ import annotations

from drivers.basler_stereo import BaslerStereoPair
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.control_port import ask_control_port
from ronna_hw.devices.readings import AreaOfInterest
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess

AREA = AreaOfInterest(896, 416, 256, 256)
LIMIT_S = 30.0  # of host time; what takes longer hangs


class Cameras:
    """Simulated cameras, and pairs that are connected to them."""

    def __init__(self, child: ChildProcess) -> None:
        self.endpoints = dict(child.ready["endpoints"])
        self.pid = child.process.pid
        self._control = child.ready["control"]
        self._pairs: list[BaslerStereoPair] = []

    @property
    def addresses(self) -> tuple[str, str]:
        """IP addresses, left and right."""
        left, right = (parse_endpoint(self.endpoints[side]).host for side in ("left", "right"))
        return left, right

    def fault(self, phrase: str) -> None:
        ask_control_port(self._control, "fault", line=f"now: camera {phrase}")

    def heal(self) -> None:
        ask_control_port(self._control, "clear_faults")

    def new_pair(self, **options: object) -> BaslerStereoPair:
        config = DeviceConfig(driver="basler_stereo", endpoints=self.endpoints, options=options)
        self._pairs.append(BaslerStereoPair("stereo", config, HostClock()))
        return self._pairs[-1]

    def streaming(self, **options: object) -> BaslerStereoPair:
        pair = self.new_pair(**options)
        pair.connect(LIMIT_S)
        pair.configure(LIMIT_S)
        pair.set_areas(AREA, AREA)
        pair.activate(LIMIT_S)
        return pair

    def show_ramp(self, pair: BaslerStereoPair) -> None:
        """Have both cameras send their fixed test image in place of what they see."""
        for camera in pair._pair:
            camera.features.choose("TestImageSelector", "Testimage1")

    def close(self) -> None:
        self.heal()
        for pair in self._pairs:
            pair.close()
        self._pairs.clear()

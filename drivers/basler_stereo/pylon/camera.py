"""Camera access through the vendor library pypylon, an optional extra."""

from __future__ import annotations

import contextlib
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.basler_stereo.errors import (
    MISSING_FEATURE,
    NO_PYLON,
    OUT_OF_RANGE,
    CameraLost,
    ControlTaken,
    NoCamera,
)
from drivers.basler_stereo.features import known_state, output_line
from drivers.basler_stereo.features.description import Number
from drivers.basler_stereo.features.feature_map import Limits
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.devices.readings import AreaOfInterest
from ronna_hw.errors import RonnaError

CONTROLLED_TEXT = "controlled by another application"  # in the library's message
EMULATED = "BaslerCamEmu"  # device class of the cameras that the library itself emulates
UNSEEN_ADVICE = (
    f"{NoCamera.action} If `ronna-procedure doctor` shows that it replies, use the driver basler_stereo."
)
LONGEST_WAIT_S = 60.0
READY_LIMIT_MS = 1000  # a trigger that arrives before the camera is ready is ignored


def load_pylon() -> tuple[Any, Any]:
    """Load the pypylon modules `pylon` and `genicam`; raises GEV-018."""
    try:
        with warnings.catch_warnings():
            # the binding warns about its own types; with warnings as errors that crashes the interpreter
            warnings.simplefilter("ignore", DeprecationWarning)
            from pypylon import genicam, pylon
    except ImportError as error:
        raise NO_PYLON("pypylon is not installed") from error
    return pylon, genicam


@dataclass(frozen=True)
class PylonFrame:
    """Image from pypylon; `pixels` is our own copy, or None for an incomplete image."""

    block_id: int
    ticks: int
    pixels: NDArray[Any] | None


class PylonCamera:
    """Camera selected by address, or by serial number if emulated.

    Deadlines are host monotonic time; the library has time limits of its own for all calls but `take`.
    """

    def __init__(
        self, side: str, address: str, serial: str | None, device_class: str, options: BaslerOptions
    ) -> None:
        self.side = side
        self._address = address
        self._serial = serial
        self._device_class = device_class
        self._options = options
        self._pylon, self._genicam = load_pylon()
        self._camera: Any = None
        self.area = AreaOfInterest(0, 0, 0, 0)
        self.tick_frequency_hz = 0

    def connect(self) -> CameraIdentity:
        """Find the camera without taking control; raises GEV-001."""
        sought_device = self._pylon.DeviceInfo()
        sought_device.SetDeviceClass(self._device_class)
        if self._device_class == EMULATED and self._serial is not None:
            sought_device.SetSerialNumber(self._serial)
        else:
            sought_device.SetIpAddress(self._address)
        try:
            self._camera = self._pylon.InstantCamera(
                self._pylon.TlFactory.GetInstance().CreateDevice(sought_device)
            )
        except self._genicam.GenericException as error:
            camera_label = self._serial if self._device_class == EMULATED else f"at {self._address}"
            raise NoCamera(
                f"the installed pylon sees no camera {camera_label}",
                got=str(error).splitlines()[0],
                action=UNSEEN_ADVICE,
            ) from error
        info = self._camera.GetDeviceInfo()
        return CameraIdentity(
            address=self._address,
            mac=info.GetMacAddress() if info.IsMacAddressAvailable() else "",
            vendor=info.GetVendorName(),
            model=info.GetModelName(),
            serial=info.GetSerialNumber(),
            version=info.GetDeviceVersion() if info.IsDeviceVersionAvailable() else "",
            user_name=info.GetUserDefinedName(),
        )

    def configure(self) -> None:
        """Take control and apply the known state; raises GEV-005, GEV-010, GEV-011, GEV-014."""
        try:
            self._camera.Open()
        except self._genicam.GenericException as error:
            if CONTROLLED_TEXT in str(error):
                raise ControlTaken(f"the {self.side} camera is controlled by another application") from error
            raise CameraLost(
                f"the {self.side} camera cannot be opened", got=str(error).splitlines()[0]
            ) from error
        features = self.features
        known_state.apply_known_state(features, self._options, f"{self.side} camera")
        if (projector := self._options.projector_at(self.side)) is not None:
            output_line.prepare_projector(features, projector, f"{self.side} camera")
        self.area = known_state.full_area(features)
        known_state.set_area(features, self.area)
        if features.has("GevTimestampTickFrequency"):
            self.tick_frequency_hz = int(features.number("GevTimestampTickFrequency"))

    @property
    def features(self) -> PylonFeatures:
        """GenICam features of the camera; available only while controlled."""
        return PylonFeatures(self._camera.GetNodeMap(), self._genicam)

    def set_area(self, area: AreaOfInterest, deadline_s: float) -> None:
        """Set the sensor area to read out, while not streaming; raises GEV-011."""
        known_state.set_area(self.features, area)
        self.area = area

    def set_exposure(self, exposure_us: float, gain_raw: int | None, deadline_s: float) -> None:
        """Set exposure and gain (None: the minimum), also while streaming; raises GEV-011."""
        known_state.set_exposure(self.features, exposure_us, gain_raw, f"{self.side} camera")

    def switch_projector(self, on: bool, deadline_s: float) -> None:
        """Switch the projector on this camera's output line, if there is one; raises GEV-021."""
        if (projector := self._options.projector_at(self.side)) is not None:
            output_line.switch_projector(self.features, projector, f"{self.side} camera", on=on)

    def start(self) -> None:
        """Start the acquisition."""
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def stop(self) -> None:
        """Stop the acquisition and discard pending images."""
        self._camera.StopGrabbing()

    def trigger(self) -> None:
        """Trigger one frame as soon as the camera is ready; raises GEV-014."""
        try:
            if self._camera.CanWaitForFrameTriggerReady():
                self._camera.WaitForFrameTriggerReady(READY_LIMIT_MS, self._pylon.TimeoutHandling_Return)
            self.features.execute("TriggerSoftware")
        except self._genicam.GenericException as error:
            raise self._lost_error(error) from error

    def take(self, deadline_s: float) -> PylonFrame | None:
        """Return the next frame, or None at the deadline; raises GEV-014."""
        remaining_s = min(LONGEST_WAIT_S, max(0.001, deadline_s - time.monotonic()))
        try:
            result = self._camera.RetrieveResult(round(remaining_s * 1e3), self._pylon.TimeoutHandling_Return)
        except self._genicam.GenericException as error:
            raise self._lost_error(error) from error
        if self._camera.IsCameraDeviceRemoved():
            raise CameraLost(f"the {self.side} camera was removed")
        if not result.IsValid():
            return None
        try:
            pixels = None
            if result.GrabSucceeded():
                pixels = np.array(result.GetArray())
                pixels.flags.writeable = False
            return PylonFrame(result.BlockID, result.TimeStamp, pixels)
        finally:
            result.Release()  # returns the buffer to the library

    def close(self, deadline_s: float) -> None:
        """Switch the projector off, release control and close; never raises."""
        if self._camera is not None:
            with contextlib.suppress(RonnaError, self._genicam.GenericException):
                self.switch_projector(False, deadline_s)
            with contextlib.suppress(self._genicam.GenericException):
                self._camera.Close()
            with contextlib.suppress(self._genicam.GenericException):
                self._camera.DestroyDevice()  # a detached camera would keep its threads and some thirty files
        self._camera = None

    def _lost_error(self, error: Exception) -> CameraLost:
        return CameraLost(f"the {self.side} camera no longer replies", got=str(error).splitlines()[0])


class PylonFeatures:
    """Features of an open camera, from its node map; unknown names and values raise GEV-010."""

    def __init__(self, nodes: Any, genicam: Any) -> None:
        self._nodes = nodes
        self._genicam = genicam

    def has(self, name: str) -> bool:
        """Return whether the feature exists and is currently available."""
        node = self._nodes.GetNode(name)
        return node is not None and bool(self._genicam.IsAvailable(node))

    def number(self, name: str) -> Number:
        """Read a numeric feature."""
        value: Number = self._find_node(name).GetValue()
        return value

    def entries(self, name: str) -> tuple[str, ...]:
        """Return the available entry names of an enumeration."""
        return tuple(self._find_node(name).Symbolics)

    def choice(self, name: str) -> str:
        """Read an enumeration and return its entry name."""
        return str(self._find_node(name).GetValue())

    def limits(self, name: str) -> Limits:
        """Return a feature's current limits."""
        node = self._find_node(name)
        step = node.GetInc() if node.GetIncMode() == self._genicam.fixedIncrement else None
        return Limits(node.GetMin(), node.GetMax(), step)

    def set_number(self, name: str, value: Number) -> None:
        """Set a numeric feature; raises GEV-011."""
        node = self._find_node(name)
        try:
            node.SetValue(value)
        except self._genicam.OutOfRangeException as error:
            raise OUT_OF_RANGE(f"{name} {value}", got=str(error).splitlines()[0]) from error
        except self._genicam.GenericException as error:
            raise MISSING_FEATURE(f"{name} cannot be set now", got=str(error).splitlines()[0]) from error

    def choose(self, name: str, entry: str) -> None:
        """Set an enumeration by entry name."""
        try:
            self._find_node(name).SetValue(entry)
        except self._genicam.GenericException as error:
            raise MISSING_FEATURE(f"{name} cannot be {entry}", got=str(error).splitlines()[0]) from error

    def execute(self, name: str) -> None:
        """Execute a command feature."""
        self._find_node(name).Execute()

    def _find_node(self, name: str) -> Any:
        if not self.has(name):
            raise MISSING_FEATURE(f"the camera has no feature {name}")
        return self._nodes.GetNode(name)

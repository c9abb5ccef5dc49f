"""Cases that every stereo pair of cameras must pass, whatever its protocol."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np

from conformance.case import OUTPUT, NotShown, Suite, check, refused, require_present
from conformance.device_cases import (
    DeviceCases,
    check_closing,
    check_connect_failure,
    check_early_calls,
    check_identity,
    check_interface,
)
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import AreaOfInterest, CameraImage, StereoReading, Validity
from ronna_hw.devices.sensors import StereoPair, line_projector
from ronna_hw.errors import ConfigurationError, ConnectError, LimitError, StateError

PAIRS = 5
CLOSE_LIMIT_S = 5.0
CONNECT_LIMIT_S = 2.0
AREA_STEP_PX = 32  # a multiple of what cameras allow
EMPTY_ENDPOINT = "gev://127.0.0.251"
EXPOSURES_US = (0.0, 1e9)  # outside every camera's limits
GAIN_RAW = 64

SUITE = Suite("stereo", driver="basler_stereo")


def grab_pairs(dut: DeviceUnderTest, count: int = PAIRS) -> list[StereoReading]:
    """Grab image pairs on the shared connection, triggering once for each."""
    pair: StereoPair = dut.at(Lifecycle.ACTIVE)
    return [pair.grab_pair() for _ in range(count)]


def require_both_images(reading: StereoReading) -> tuple[CameraImage, CameraImage]:
    """Return the left and right images; raises Nonconformity unless the pair is complete."""
    check(reading.validity is Validity.OK, "a complete pair", reading.validity)
    what = "an image from both cameras in a complete pair"
    return require_present(reading.left, what), require_present(reading.right, what)


SUITE.case("S01", "the driver implements StereoPair and starts disconnected")(
    partial(check_interface, interface=StereoPair)
)


@SUITE.case("S02", "connecting identifies the cameras, and which is left and right")
def identity_is_answered(dut: DeviceUnderTest) -> None:
    pair, identity = check_identity(dut)
    left, right = pair.serials
    check(bool(left and right) and left != right, "two serial numbers", pair.serials)
    check(left in identity.serial and right in identity.serial, "both in the identity", identity.serial)


@SUITE.case("S03", "calls in the wrong state are refused")
def early_calls_are_refused(dut: DeviceUnderTest) -> None:
    pair = check_early_calls(
        dut,
        disconnected=("configure", "activate", "deactivate", "grab_pair"),
        connected=("connect", "activate", "grab_pair"),
    )
    pair.configure()
    refused(pair.grab_pair, StateError, "grab_pair before activate")


@SUITE.case("S04", "one trigger yields one complete pair, each image from the camera of its side")
def one_pair_per_trigger(dut: DeviceUnderTest) -> None:
    for reading in grab_pairs(dut):
        images = require_both_images(reading)
        serials = tuple(image.serial for image in images)
        check(serials == dut.at(Lifecycle.ACTIVE).serials, "the serial numbers of the sides", serials)


@SUITE.case("S05", "readings are numbered consecutively, and every clock advances")
def stamps_are_in_order(dut: DeviceUnderTest) -> None:
    for before, after in itertools.pairwise(grab_pairs(dut)):
        check(after.stamp.sequence == before.stamp.sequence + 1, "the next number", after.stamp.sequence)
        check(after.stamp.theatre_time_s >= before.stamp.theatre_time_s, "a later theatre time")
        for earlier, later in zip(require_both_images(before), require_both_images(after), strict=True):
            check(later.stamp.device_clock > earlier.stamp.device_clock, "a later camera time", later.stamp)


@SUITE.case("S06", "an image has the shape of its area and 8 or 12 bits, and is read-only")
def images_have_their_shape(dut: DeviceUnderTest) -> None:
    for image in require_both_images(grab_pairs(dut, 1)[0]):
        area = image.area
        check(image.pixels.shape == (area.height, area.width), f"shape of {area}", image.pixels.shape)
        check(image.pixels.dtype in (np.uint8, np.uint16), "uint8 or uint16", image.pixels.dtype)
        check(int(image.pixels.max()) < 4096, "values of at most 12 bits", image.pixels.max())
        check(not image.pixels.flags.writeable, "a read-only array")


@SUITE.case("S07", "images have the area that was set, also on a running stream")
def areas_are_honoured(dut: DeviceUnderTest) -> None:
    pair = dut.at(Lifecycle.ACTIVE)
    whole = [image.area for image in require_both_images(pair.grab_pair())]
    parts = [_middle_part(area) for area in whole]
    pair.set_areas(*parts)
    found = [image.area for image in require_both_images(pair.grab_pair())]
    check(found == parts, f"the areas {parts}", found)
    pair.set_areas(*whole)
    found = [image.area for image in require_both_images(pair.grab_pair())]
    check(found == whole, f"the areas {whole}", found)


@SUITE.case("S08", "an area beyond the sensor is refused, and the old one is kept")
def impossible_areas_are_refused(dut: DeviceUnderTest) -> None:
    pair = dut.at(Lifecycle.ACTIVE)
    whole = [image.area for image in require_both_images(pair.grab_pair())]
    beyond = AreaOfInterest(0, 0, 64 * whole[0].width, whole[0].height)
    refused(lambda: pair.set_areas(beyond, whole[1]), LimitError, "an area wider than the sensor")
    refused(
        lambda: pair.set_areas(_middle_part(whole[0]), beyond),
        LimitError,
        "such an area for the right camera",
    )
    found = [image.area for image in require_both_images(pair.grab_pair())]
    check(found == whole, f"the areas {whole}", found)


@SUITE.case("S09", "an exposure out of range is refused")
def impossible_exposures_are_refused(dut: DeviceUnderTest) -> None:
    pair = dut.at(Lifecycle.ACTIVE)
    for exposure_us in EXPOSURES_US:
        refused(partial(pair.set_exposure, exposure_us, GAIN_RAW), LimitError, f"{exposure_us} us")
    require_both_images(pair.grab_pair())


@SUITE.case("S10", "a stopped stream can be started again")
def stream_starts_again(dut: DeviceUnderTest) -> None:
    pair = dut.at(Lifecycle.ACTIVE)
    pair.deactivate()
    refused(pair.grab_pair, StateError, "grab_pair after deactivate")
    pair.activate()
    require_both_images(pair.grab_pair())


@SUITE.case("S11", "a second controller is refused, and the first keeps control")
def second_controller_is_refused(dut: DeviceUnderTest) -> None:
    pair = dut.at(Lifecycle.ACTIVE)
    second = dut.make_beside()
    try:
        second.connect()
        refused(second.configure, ConnectError, "configure while another application has control")
    finally:
        second.close()
    require_both_images(pair.grab_pair())


@SUITE.case("S12", "swapped cameras are noticed when serial numbers are given")
def swapped_cameras_are_noticed(dut: DeviceUnderTest) -> None:
    pair = dut.make()
    pair.connect()
    left, right = pair.serials
    dut.release()
    roles = dict(dut.config.endpoints)
    if set(roles) != {"left", "right"}:
        raise NotShown("the two cameras have no endpoint each")
    options = {**dut.config.options, "left_serial": left, "right_serial": right}
    try:
        bound = dut.make_beside(options=options)
        swapped = dut.make_beside(options=options, endpoints={"left": roles["right"], "right": roles["left"]})
    except ConfigurationError as error:
        raise NotShown("the driver has no options for serial numbers") from error
    try:
        bound.connect()
        refused(swapped.connect, ConnectError, "connect with swapped addresses")
    finally:
        bound.close()
        swapped.close()


@SUITE.case("S13", "connecting to an address without a camera fails in time")
def no_camera_there(dut: DeviceUnderTest) -> None:
    if set(dut.config.endpoints) != {"left", "right"}:
        raise NotShown("the two cameras have no endpoint each")
    incomplete_pair = dut.make_beside(endpoints={**dut.config.endpoints, "right": EMPTY_ENDPOINT})
    check_connect_failure(incomplete_pair, CONNECT_LIMIT_S)


@SUITE.case("S14", "closing ends in bounded time, is final, and releases control")
def closing_is_bounded(dut: DeviceUnderTest) -> None:
    pair = dut.make()
    dut.bring_to(Lifecycle.ACTIVE, pair)
    check_closing(pair, CLOSE_LIMIT_S)
    require_both_images(dut.at(Lifecycle.ACTIVE).grab_pair())


@SUITE.case(
    "S19", "a line projector switches on and off, and the end of the streams switches it off", needs=(OUTPUT,)
)
def projector_switches(dut: DeviceUnderTest) -> None:
    pair = dut.at(Lifecycle.ACTIVE)
    if (projector := line_projector(pair)) is None:
        raise NotShown("the theatre file names no line projector")
    check(not projector.projector_on, "a projector that is off when the streams start")
    for on in (True, False, True):
        projector.set_projector(on)
        check(projector.projector_on == on, f"a projector that is {'on' if on else 'off'}")
        require_both_images(pair.grab_pair())
    pair.deactivate()
    check(not projector.projector_on, "a projector that is off once the streams have stopped")
    pair.activate()


SUITE.cases.extend(DeviceCases(lambda pair: pair.grab_pair(), CLOSE_LIMIT_S).build_cases("S", 15))


def _middle_part(area: AreaOfInterest) -> AreaOfInterest:
    """Return the central part of an area, aligned to steps that cameras accept."""

    def step(value: int) -> int:
        return value // AREA_STEP_PX * AREA_STEP_PX

    width, height = step(area.width // 2), step(area.height // 2)
    x, y = step((area.width - width) // 2), step((area.height - height) // 2)
    return AreaOfInterest(area.offset_x + x, area.offset_y + y, width, height)

"""Our camera client against a third-party camera: the fake camera of Aravis.

Needs Debian's package aravis-tools (`arv-fake-gv-camera-0.8`) and nobody else on 127.0.0.1:3956.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import subprocess
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from run_strangers import run_server
from stranger_catalogue import ARAVIS_CAMERAS
from strangers_table import PASSES

from drivers.basler_stereo.camera import Camera
from drivers.basler_stereo.control_channel import send_together
from drivers.basler_stereo.errors import OUT_OF_RANGE
from drivers.basler_stereo.identity import discover_cameras
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.readings import camera_image
from drivers.basler_stereo.stream.receiver import ReceiverProcess
from ronna_hw.devices.readings import AreaOfInterest, Validity
from ronna_hw.host.network import find_interface
from ronna_hw.wire.gige_vision import GVCP_PORT, Bootstrap, PixelFormat

FAKE_CAMERA = shutil.which("arv-fake-gv-camera-0.8")
ADDRESS = "127.0.0.1"
SERIAL = "STRANGER01"
HANG_LIMIT_S = 30.0
OPTIONS = BaslerOptions(expected_model="", packet_bytes=1500)
AREA = AreaOfInterest(64, 32, 640, 480)

pytestmark = pytest.mark.skipif(
    FAKE_CAMERA is None,
    reason="no arv-fake-gv-camera-0.8 here: install the Debian package aravis-tools to test with a stranger",
)


@contextmanager
def in_turns():
    """One at a time on this machine: a second fake camera would share the address with the first."""
    with (Path(tempfile.gettempdir()) / f"ronna-fake-camera-{os.getuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextmanager
def fake_camera(*options: str):
    assert FAKE_CAMERA is not None
    with in_turns():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((ADDRESS, GVCP_PORT))
            except OSError:
                pytest.skip(f"another program has {ADDRESS}:{GVCP_PORT}, which the fake camera needs")
        process = subprocess.Popen(
            [FAKE_CAMERA, "-i", ADDRESS, "-s", SERIAL, *options],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield
        finally:
            process.terminate()
            process.wait(HANG_LIMIT_S)


def soon(limit_s: float = HANG_LIMIT_S) -> float:
    return time.monotonic() + limit_s


@contextmanager
def controlled(*options: str):
    with fake_camera(*options):
        camera = Camera("left", ADDRESS, OPTIONS)
        identity = camera.connect(soon())
        assert (identity.vendor, identity.model, identity.serial) == ("Aravis", "Fake", SERIAL)
        reception = ReceiverProcess()
        try:
            camera.configure(reception, soon())
            yield camera
        finally:
            camera.close(soon(1.0))
            reception.close()


def grab(camera: Camera):
    assert send_together([(camera.control, camera.trigger_command)], soon(), "the trigger") == [None]
    frame = camera.take(soon())
    assert frame is not None
    return frame


def test_a_third_party_camera_answers_broadcast_discovery():
    with fake_camera():
        deadline_s = soon()
        while SERIAL not in (
            found := {each.serial: each for each in discover_cameras(find_interface(ADDRESS))}
        ):
            assert time.monotonic() < deadline_s, "the fake camera did not start, or hears nobody"
    assert (found[SERIAL].vendor, found[SERIAL].model) == ("Aravis", "Fake")


def test_a_third_party_camera_can_be_configured_triggered_and_grabbed_from():
    with controlled() as camera:
        assert camera.area == AreaOfInterest(0, 0, 2048, 2048)
        camera.set_area(AREA, soon())
        camera.set_exposure(3000.0, 7, soon())
        assert camera.features.number("ExposureTimeAbs") == 3000.0
        assert camera.features.number("GainRaw") == 7
        with raises(OUT_OF_RANGE):
            camera.set_exposure(3000.0, 11, soon())
        camera.start(soon())
        frames = [grab(camera) for _ in range(3)]
        steps = np.diff([frame.block_id for frame in frames])
        assert steps.tolist() == [1, 1]
        images = [camera_image(frame, SERIAL, AREA, PixelFormat.MONO8, 1, 0.0) for frame in frames]
        assert [image.validity for image in images] == [Validity.OK] * 3
        assert images[0].pixels.shape == (480, 640)
        assert np.ptp(images[0].pixels) > 100  # a moving pattern, not an even field
        assert not np.array_equal(images[0].pixels, images[1].pixels)
        assert images[0].stamp.device_clock < images[1].stamp.device_clock
        camera.stop(soon())
        assert camera.control.read_register(Bootstrap.CCP, soon()) != 0
        camera.release(soon())
        assert camera.control.read_register(Bootstrap.CCP, soon()) == 0


@pytest.mark.slow
def test_the_heartbeat_keeps_control_of_a_third_party_camera():
    with controlled() as camera:
        time.sleep(1.2 * camera.control.read_register(Bootstrap.HEARTBEAT_TIMEOUT_MS, soon()) / 1000.0)
        assert camera.lost is None
        assert camera.control.read_register(Bootstrap.CCP, soon()) != 0


def test_packets_lost_for_good_by_a_third_party_camera_are_counted():
    with controlled("-r", "20") as camera:  # 2 % lost, and this camera knows no resend
        camera.set_area(AREA, soon())
        camera.start(soon())
        missing = 0
        for _ in range(5):
            frame = grab(camera)
            missing += frame.missing_packets
            if missing:
                image = camera_image(frame, SERIAL, AREA, PixelFormat.MONO8, 1, 0.0)
                assert image is None or image.validity is Validity.PARTIAL
                break
        assert missing > 0
        assert camera.counters.resend_requests > 0


@pytest.mark.slow
def test_a_pair_of_third_party_cameras_passes_the_generic_suite() -> None:
    found = run_server(ARAVIS_CAMERAS, "")
    if found is None:
        pytest.skip("this machine allows no network namespace, in which two fake cameras find room")
    # the fake camera leaves a write that it refuses unanswered
    assert "GEV-007" in found.cases.pop("S11")
    assert {number: outcome for number, outcome in found.cases.items() if outcome != PASSES} == {}
    assert len(found.cases) == 17

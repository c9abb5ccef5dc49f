"""Aravis 0.8 by its Python bindings, which the distribution's own Python has."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import Any

import gi
from simulated_peer import eventually, inject

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis  # noqa: E402

LEFT, RIGHT = os.environ["LEFT"], os.environ["RIGHT"]
FRAME_LIMIT_US = 5_000_000
SOCKET_BYTES, RETENTION_US = 4 << 20, 4_000_000  # for a busy computer
BUFFERS = 8
KILLED_WITH_CONTROL = """
import os, gi
gi.require_version("Aravis", "0.8")
from gi.repository import Aravis
camera = Aravis.Camera.new(os.environ["LEFT"])
os.kill(os.getpid(), 9) if not camera.get_device().is_controller() else os._exit(0)
"""


def opened(address: str = LEFT, trigger: str = "Software") -> tuple[Any, Any]:
    camera = Aravis.Camera.new(address)
    camera.set_region(0, 0, 512, 512)
    camera.set_pixel_format(Aravis.PIXEL_FORMAT_MONO_8)
    camera.set_exposure_time(3000.0)
    if trigger:
        camera.set_trigger(trigger)
    camera.gv_set_packet_size(1500)
    camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
    stream = camera.create_stream(None, None)
    stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
    stream.set_property("socket-buffer-size", SOCKET_BYTES)
    stream.set_property("frame-retention", RETENTION_US)
    stream.set_property("packet-request-ratio", 1.0)
    for _ in range(BUFFERS):
        stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
    camera.start_acquisition()
    return camera, stream


def grab(camera: Any, stream: Any) -> Any:
    camera.software_trigger()
    return stream.timeout_pop_buffer(FRAME_LIMIT_US)


def is_whole(buffer: Any) -> bool:
    return buffer is not None and buffer.get_status() == Aravis.BufferStatus.SUCCESS


def finds_cameras_by_broadcast() -> None:
    found = subprocess.run(["arv-tool-0.8"], capture_output=True, text=True, check=True, timeout=20).stdout
    assert f"({LEFT})" in found
    assert f"({RIGHT})" in found


def reads_the_description() -> None:
    camera = Aravis.Camera.new(LEFT)
    assert (camera.get_vendor_name(), camera.get_model_name()) == ("Basler", "acA2000-50gmNIR")
    assert camera.get_exposure_time_bounds()


def writes_features() -> None:
    camera = Aravis.Camera.new(LEFT)
    camera.set_exposure_time(1234.0)
    camera.set_region(0, 0, 1024, 512)
    assert camera.get_exposure_time() == 1234.0
    assert camera.get_region()[2:] == (1024, 512)


def grabs_triggered_frames() -> None:
    camera, stream = opened()
    assert all(is_whole(grab(camera, stream)) for _ in range(3))


def grabs_free_running_frames() -> None:
    camera, stream = opened(trigger="")
    camera.clear_triggers()
    assert all(is_whole(stream.timeout_pop_buffer(FRAME_LIMIT_US)) for _ in range(3))


def grabs_from_two_cameras() -> None:
    both = [opened(LEFT), opened(RIGHT)]
    assert all(is_whole(grab(*one)) for one in both)


def numbers_and_stamps_frames() -> None:
    camera, stream = opened()
    frames = [grab(camera, stream) for _ in range(3)]
    assert [frame.get_frame_id() for frame in frames] == [1, 2, 3]
    stamps = [frame.get_timestamp() for frame in frames]
    assert stamps == sorted(set(stamps))


def gets_every_frame_although_packets_are_lost() -> None:
    camera, stream = opened()
    inject("camera drop 2 %")
    assert all(is_whole(grab(camera, stream)) for _ in range(5))
    assert stream.get_info_uint64_by_name("n_resent_packets") > 0


def gets_every_frame_although_packets_are_shuffled() -> None:
    camera, stream = opened()
    inject("camera shuffle left")
    assert all(is_whole(grab(camera, stream)) for _ in range(3))


def tells_a_frame_with_missing_packets() -> None:
    camera, stream = opened()
    inject("camera drop 10 %")
    inject("camera forget left")
    buffer = grab(camera, stream)
    assert buffer is None or not is_whole(buffer), "a frame with holes passes for a whole one"


def tells_a_frame_of_half_its_data() -> None:
    camera, stream = opened()
    inject("camera truncate left")
    buffer = grab(camera, stream)
    assert buffer is None or not is_whole(buffer), "half a frame passes for a whole one"


def tells_that_another_application_has_control() -> None:
    inject("camera seize left")
    camera = Aravis.Camera.new(LEFT)
    assert not camera.get_device().is_controller()
    before = camera.get_exposure_time()
    try:
        camera.set_exposure_time(before + 1000.0)
    except gi.repository.GLib.Error:
        return
    raise AssertionError("a refused write passes for done")


def tells_that_the_camera_has_gone() -> None:
    lost: list[object] = []
    camera = Aravis.Camera.new(LEFT)
    camera.get_device().connect("control-lost", lost.append)
    inject("camera unplug left")
    assert eventually(lambda: lost, 15.0), "no signal says that control is lost"


def keeps_control_between_frames() -> None:
    camera, stream = opened()
    time.sleep(1.5 * camera.get_device().get_integer_feature_value("GevHeartbeatTimeout") / 1000.0)
    assert is_whole(grab(camera, stream))


def takes_control_after_one_was_killed() -> None:
    subprocess.run([sys.executable, "-c", KILLED_WITH_CONTROL], check=True, timeout=20)
    assert eventually(lambda: Aravis.Camera.new(LEFT).get_device().is_controller())


def finds_the_largest_packet() -> None:
    inject("camera narrow path left 1500 bytes")
    camera = Aravis.Camera.new(LEFT)
    assert camera.gv_auto_packet_size() <= 1500

"""Aravis client for two free-running cameras, run by the system Python, the only one with its bindings.

    /usr/bin/python3 aravis_stream.py '{"addresses": [...], "pairs": N, "packet_bytes": 8000}'

Prints one JSON line: pairs, seconds, CPU seconds, incomplete frames, packets resent.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import gi

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis  # noqa: E402

BUFFERS = 16
SOCKET_BYTES = 4 << 20
RETENTION_US = 4_000_000
LIMIT_US = 5_000_000


def open_stream(address: str, packet_bytes: int) -> tuple[Any, Any]:
    camera = Aravis.Camera.new(address)
    camera.set_pixel_format(Aravis.PIXEL_FORMAT_MONO_8)
    camera.set_exposure_time(2000.0)
    camera.clear_triggers()
    camera.gv_set_packet_size(packet_bytes)
    camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
    stream = camera.create_stream(None, None)
    stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
    stream.set_property("socket-buffer-size", SOCKET_BYTES)
    stream.set_property("frame-retention", RETENTION_US)
    for _ in range(BUFFERS):
        stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
    return camera, stream


def main(job: dict[str, Any]) -> None:
    both = [open_stream(address, job["packet_bytes"]) for address in job["addresses"]]
    for camera, _ in both:
        camera.start_acquisition()
    broken = 0
    for _, stream in both:  # the first images are still being drawn
        stream.push_buffer(stream.timeout_pop_buffer(LIMIT_US))
    wall_s, cpu_s = time.monotonic(), time.process_time()
    for _ in range(job["pairs"]):
        for _, stream in both:
            buffer = stream.timeout_pop_buffer(LIMIT_US)
            broken += buffer is None or buffer.get_status() != Aravis.BufferStatus.SUCCESS
            if buffer is not None:
                stream.push_buffer(buffer)
    wall_s, cpu_s = time.monotonic() - wall_s, time.process_time() - cpu_s
    repeated = 0
    for camera, stream in both:
        camera.stop_acquisition()
        repeated += stream.get_info_uint64_by_name("n_resent_packets")
    print(json.dumps({"seconds": wall_s, "cpu_s": cpu_s, "broken": broken, "repeated": repeated}))


main(json.loads(sys.argv[1]))

"""Each camera belongs to its side, both are one device, and wrong options are refused."""

from __future__ import annotations

import itertools
import select
import socket
import struct
import time
from dataclasses import replace
from typing import Any

import pytest
from coded_errors import raises

from drivers.basler_stereo.errors import (
    BAD_OPTIONS,
    CABLES_SWAPPED,
    WRONG_MODEL,
    WRONG_SERIAL,
    MalformedReply,
)
from drivers.basler_stereo.identity import CameraIdentity, decode_identity, discover_cameras
from drivers.basler_stereo.options import BaslerOptions, read_options
from drivers.basler_stereo.pair_device import check_pair, pair_identity
from ronna_hw.config import DeviceConfig
from ronna_hw.host.network import Interface
from ronna_hw.wire.gige_vision import PixelFormat

BOUND = BaslerOptions(left_serial="11", right_serial="22")
LEFT = CameraIdentity("10.0.0.1", "00:30:53:11:22:33", "Basler", "acA2000-50gmNIR", "11", "106755-17", "left")
RIGHT = replace(LEFT, address="10.0.0.2", serial="22", user_name="right")


def test_the_right_cameras_on_the_right_sides_pass():
    check_pair(LEFT, RIGHT, BOUND)
    check_pair(LEFT, RIGHT, BaslerOptions())
    check_pair(LEFT, RIGHT, BaslerOptions(right_serial="22"))


@pytest.mark.parametrize(
    ("left", "right", "options", "error"),
    [
        (RIGHT, LEFT, BOUND, CABLES_SWAPPED),
        (RIGHT, LEFT, BaslerOptions(left_serial="11"), CABLES_SWAPPED),
        (LEFT, replace(RIGHT, serial="33"), BOUND, WRONG_SERIAL),
        (replace(LEFT, serial="33"), RIGHT, BOUND, WRONG_SERIAL),
        (LEFT, LEFT, BaslerOptions(), WRONG_SERIAL),
        (LEFT, replace(RIGHT, model="Fake"), BOUND, WRONG_MODEL),
    ],
)
def test_wrong_cameras_are_refused_with_the_matching_error(left, right, options, error):
    with raises(error, match=error.code):
        check_pair(left, right, options)


@pytest.mark.parametrize("options", [BaslerOptions(), BOUND])
def test_cameras_that_name_two_owners_are_no_pair_even_with_the_expected_serial_numbers(options):
    ours, theirs = replace(LEFT, info="ronna-sim, process 6"), replace(RIGHT, info="ronna-sim, process 7")
    with raises(WRONG_SERIAL, match="different owners"):
        check_pair(ours, theirs, options)
    check_pair(replace(LEFT, info=theirs.info), theirs, options)
    check_pair(LEFT, theirs, options)  # as from the factory


def test_any_model_can_be_allowed():
    check_pair(LEFT, replace(RIGHT, model="Fake"), BaslerOptions(expected_model=""))


def test_the_identity_of_the_pair_names_both_cameras():
    identity = pair_identity(LEFT, RIGHT)
    assert identity.serial == "11+22"
    assert dict(identity.details)["right"].startswith("22 ")


ENDPOINTS = {"left": "gev://127.0.0.1", "right": "gev://127.0.0.2"}


def options(**values):
    config = DeviceConfig(driver="basler_stereo", endpoints=ENDPOINTS, options=values)
    return read_options(config, BaslerOptions)


def test_every_option_has_a_working_default():
    assert options().expected_model == "acA2000-50gmNIR"
    assert options(exposure_us=500).exposure_us == 500.0
    assert options(pixel_format="Mono12").pixel_format_code is PixelFormat.MONO12


def test_all_mistakes_are_reported_at_once():
    with raises(BAD_OPTIONS, match=r"GEV-016.*3 mistake") as caught:
        options(exposure="long", gain_raw=1000, heartbeat_ms=10)
    for word in ("exposure", "gain_raw", "heartbeat_ms"):
        assert word in str(caught.value)


def test_one_camera_cannot_be_both_sides():
    with raises(BAD_OPTIONS, match="serial are equal"):
        options(left_serial="1", right_serial="1")


def test_an_option_that_is_not_a_plain_value_is_refused():
    with raises(BAD_OPTIONS, match="GEV-016"):
        options(left_serial=object())


def test_a_serial_number_without_quotes_is_refused_with_the_advice_to_put_it_in_quotes():
    with raises(BAD_OPTIONS, match=r"left_serial: expected text: put it in quotes \(found 21904411\)"):
        options(left_serial=21904411)


def memory(serial="21900001", model="acA2000-50gmNIR"):
    data = bytearray(248)
    data[0x08:0x10] = struct.pack(">HHI", 0, 0x0030, 0x53112233)
    for place, text in ((0x48, "Basler"), (0x68, model), (0x88, "106755-17"), (0xD8, serial), (0xE8, "left")):
        data[place : place + len(text)] = text.encode()
    return bytes(data)


def test_the_reply_identifies_the_camera():
    found = decode_identity(memory(), "10.0.0.1")
    assert (found.vendor, found.model, found.serial) == ("Basler", "acA2000-50gmNIR", "21900001")
    assert (found.version, found.user_name, found.mac) == ("106755-17", "left", "00:30:53:11:22:33")


def test_a_camera_says_whose_it_is_if_its_maker_information_was_set():
    data = bytearray(memory())
    data[0xA8:0xAC] = b"none"
    assert str(decode_identity(bytes(data), "10.0.0.1")) == "acA2000-50gmNIR 21900001 at 10.0.0.1"
    data[0xA8:0xB1] = b"theatre 2"
    assert str(decode_identity(bytes(data), "10.0.0.1")).endswith("10.0.0.1 (theatre 2)")


def test_a_reply_of_another_length_is_malformed():
    with pytest.raises(MalformedReply, match="GEV-008"):
        decode_identity(memory()[:-1], "10.0.0.1")


def test_text_that_is_not_utf8_is_still_read():
    data = bytearray(memory())
    data[0x48:0x68] = b"\xff" * 32
    assert decode_identity(bytes(data), "x").vendor


LIMIT_S = 0.5
A_DATAGRAM_S = 0.1  # what each takes by this test's clock
MOST_READ = 10


class FloodedSocket(socket.socket):
    """Socket with always another datagram to read that is no camera's reply."""

    read = 0

    def sendto(self, *_: Any) -> int:
        return 0

    def recvfrom(self, *_: Any) -> tuple[bytes, tuple[str, int]]:
        FloodedSocket.read += 1
        assert FloodedSocket.read <= MOST_READ, "discovery goes on after its time"
        return b"flood", ("127.0.0.1", 9)


def test_a_flood_of_datagrams_does_not_prolong_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(0.0, A_DATAGRAM_S)
    monkeypatch.setattr(socket, "socket", FloodedSocket)
    monkeypatch.setattr(select, "select", lambda readers, *_: (readers, [], []))
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    assert discover_cameras(Interface("lo", "127.0.0.1", 8, 0), LIMIT_S) == ()
    assert FloodedSocket.read < LIMIT_S / A_DATAGRAM_S

"""The discovery answer, and which camera belongs to which side."""

from __future__ import annotations

import struct
from dataclasses import replace

import pytest

from drivers.basler_stereo.discovery import check_pair, decode_identity, pair_identity
from drivers.basler_stereo.errors import BrokenAnswer, CablesSwapped, WrongModel, WrongSerial
from drivers.basler_stereo.options import BaslerOptions

BOUND = BaslerOptions(left_serial="11", right_serial="22")


def memory(serial="21900001", model="acA2000-50gmNIR"):
    data = bytearray(248)
    data[0x08:0x10] = struct.pack(">HHI", 0, 0x0030, 0x53112233)
    for place, text in ((0x48, "Basler"), (0x68, model), (0x88, "106755-17"), (0xD8, serial), (0xE8, "left")):
        data[place : place + len(text)] = text.encode()
    return bytes(data)


LEFT = replace(decode_identity(memory("11"), "10.0.0.1"))
RIGHT = replace(decode_identity(memory("22"), "10.0.0.2"))


def test_the_answer_tells_who_is_there():
    found = decode_identity(memory(), "10.0.0.1")
    assert (found.vendor, found.model, found.serial) == ("Basler", "acA2000-50gmNIR", "21900001")
    assert (found.version, found.user_name, found.mac) == ("106755-17", "left", "00:30:53:11:22:33")


def test_an_answer_of_another_length_is_broken():
    with pytest.raises(BrokenAnswer, match="GEV-008"):
        decode_identity(memory()[:-1], "10.0.0.1")


def test_text_that_is_no_utf8_does_not_upset_anybody():
    data = bytearray(memory())
    data[0x48:0x68] = b"\xff" * 32
    assert decode_identity(bytes(data), "x").vendor


def test_the_right_cameras_on_the_right_sides_pass():
    check_pair(LEFT, RIGHT, BOUND)
    check_pair(LEFT, RIGHT, BaslerOptions())
    check_pair(LEFT, RIGHT, BaslerOptions(right_serial="22"))


@pytest.mark.parametrize(
    ("left", "right", "options", "error"),
    [
        (RIGHT, LEFT, BOUND, CablesSwapped),
        (RIGHT, LEFT, BaslerOptions(left_serial="11"), CablesSwapped),
        (LEFT, replace(RIGHT, serial="33"), BOUND, WrongSerial),
        (replace(LEFT, serial="33"), RIGHT, BOUND, WrongSerial),
        (LEFT, LEFT, BaslerOptions(), WrongSerial),
        (LEFT, replace(RIGHT, model="Fake"), BOUND, WrongModel),
    ],
)
def test_other_cameras_are_refused_by_name(left, right, options, error):
    with pytest.raises(error, match=error.code):
        check_pair(left, right, options)


def test_any_model_may_be_allowed():
    check_pair(LEFT, replace(RIGHT, model="Fake"), BaslerOptions(expected_model=""))


def test_the_identity_of_the_pair_names_both():
    identity = pair_identity(LEFT, RIGHT)
    assert identity.serial == "11+22"
    assert dict(identity.details)["right"].startswith("22 ")

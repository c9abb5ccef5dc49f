"""Which camera belongs to which side, and both as one device."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.basler_stereo.errors import CablesSwapped, WrongModel, WrongSerial
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.pair_device import check_pair, pair_identity

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
        (RIGHT, LEFT, BOUND, CablesSwapped),
        (RIGHT, LEFT, BaslerOptions(left_serial="11"), CablesSwapped),
        (LEFT, replace(RIGHT, serial="33"), BOUND, WrongSerial),
        (replace(LEFT, serial="33"), RIGHT, BOUND, WrongSerial),
        (LEFT, LEFT, BaslerOptions(), WrongSerial),
        (LEFT, replace(RIGHT, model="Fake"), BOUND, WrongModel),
    ],
)
def test_wrong_cameras_are_refused_with_the_matching_error(left, right, options, error):
    with pytest.raises(error, match=error.code):
        check_pair(left, right, options)


def test_any_model_can_be_allowed():
    check_pair(LEFT, replace(RIGHT, model="Fake"), BaslerOptions(expected_model=""))


def test_the_identity_of_the_pair_names_both_cameras():
    identity = pair_identity(LEFT, RIGHT)
    assert identity.serial == "11+22"
    assert dict(identity.details)["right"].startswith("22 ")

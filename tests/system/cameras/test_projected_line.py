"""The projector's line through the wire: switched by the driver, seen by both cameras in one pair."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from spoilt_cameras import Stand

from drivers.basler_stereo.pair import BaslerStereoPair
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.readings import CameraImage, Validity
from sim.world.options import Carrier
from sim.world.rigid import inverse, matrix_from, matrix_of, rotation_towards
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.skin import skin_point
from sim.world.world import ArmState, World

TRIES = 5
BRIGHT = 60  # of 255: far above the skin beside the line


@pytest.fixture
def pair() -> Iterator[BaslerStereoPair]:
    scene = draw_scene("mini", fiducials=Carrier.SURFACE)
    stand = Stand(scene)
    look_at_brow(stand.world, scene)
    options = {"left_serial": scene.left.serial, "projector": {"line": "Out1"}}
    config = DeviceConfig(driver="basler_stereo", endpoints=stand.pair.endpoints, options=options)
    device = BaslerStereoPair("stereo", config, HostClock())
    try:
        device.connect()
        device.configure()
        device.activate()
        yield device
    finally:
        device.close()
        stand.close()


def look_at_brow(world: World, scene: Scene) -> None:
    """Put the true tool centre point on the skin between brow and hair line, the head along its normal."""
    point, normal = skin_point(scene.head, np.array([0.2, -1.0, 0.1]))
    tool = matrix_of(scene.head.robot_from_ct) @ matrix_from(
        point, rotation_towards(-normal, (0.0, 0.0, 1.0))
    )
    flange = tool @ inverse(matrix_of(scene.mount.flange_from_tool_true))
    world.publish_arm(ArmState((0.0,) * 6, flange, 1, True))


def lit_rows(pair: BaslerStereoPair) -> tuple[int, int]:
    """Count the lit rows of both images, of the first pair that a busy computer receives whole."""
    reading = next(one for one in (pair.grab_pair() for _ in range(TRIES)) if one.validity is Validity.OK)

    def count(image: CameraImage | None) -> int:
        assert image is not None
        return int((image.pixels.max(axis=1) > BRIGHT).sum())

    return count(reading.left), count(reading.right)


def test_both_cameras_see_the_line_while_the_projector_is_on(pair: BaslerStereoPair) -> None:
    assert lit_rows(pair) == (0, 0)
    pair.set_projector(True)
    assert min(lit_rows(pair)) > 800
    pair.set_projector(False)
    assert lit_rows(pair) == (0, 0)


def test_the_line_goes_out_with_the_streams(pair: BaslerStereoPair) -> None:
    pair.set_projector(True)
    pair.deactivate()
    pair.activate()
    assert lit_rows(pair) == (0, 0)

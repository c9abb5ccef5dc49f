"""Instruments that are bent, too long, or loose in the assistant's clamp."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from numpy.typing import NDArray

from sim.errors import STAND_NOT_READY
from sim.world.faults import check_faults, parse_faults
from sim.world.options import ArmRole
from sim.world.rigid import apply, inverse, matrix_from, matrix_of
from sim.world.scene.assistant import add_assistant
from sim.world.scene.named_scenes import draw_scene
from sim.world.truth import TrueGuide, sample_instrument, sample_seated_instrument
from sim.world.world import ArmState, World

STOP_MM = 170.0
JOINTS = (0.0,) * 6


@pytest.fixture
def world() -> World:
    """The guide over the patient, and the assistant's clamp on its axis, at the end of its way."""
    scene = add_assistant(draw_scene("mini"))
    world = World.create(scene, paced=False)
    world.mount_tool(scene.mount.tool_number_guide)
    world.publish_arm(ArmState(JOINTS, matrix_from((700.0, 0.0, 400.0), np.diag([1.0, -1.0, -1.0])), 1, True))
    assert scene.assistant is not None
    bore = scene.mount.guide
    seated = TrueGuide(world).tip_frame() @ matrix_from((0.0, 0.0, -bore.bore_mm - bore.reach_mm), np.eye(3))
    base, clamp = scene.assistant.robot_from_base, scene.assistant.flange_from_clamp
    flange = inverse(matrix_of(base)) @ seated @ inverse(matrix_of(clamp))
    world.publish_arm(ArmState(JOINTS, flange, 1, True), ArmRole.ASSISTANT)
    return world


def in_guide_mm(world: World, tip_mm: tuple[float, float, float]) -> NDArray[np.float64]:
    return apply(inverse(TrueGuide(world).tip_frame()), tip_mm)


def seated_mm(world: World, script: str = "") -> tuple[NDArray[np.float64], float]:
    """Tip of a seated instrument in the frame of the guide's tip, and the gap at its stop."""
    world.set_fault_script(script)
    sample, gap_mm = sample_seated_instrument(world, TrueGuide(world), "T1", STOP_MM)
    return in_guide_mm(world, sample.tip_mm), gap_mm


@pytest.mark.parametrize(
    ("fault", "off_mm"),
    [("bent instrument 0.4 -0.3 mm", (0.4, -0.3, 0.0)), ("wrong instrument 2 mm", (0.0, 0.0, 2.0))],
)
def test_a_bent_or_long_instrument_ends_that_far_off_whoever_inserts_it(
    world: World, fault: str, off_mm: tuple[float, float, float]
) -> None:
    by_hand = sample_instrument(world, TrueGuide(world), "T1", STOP_MM, 0)
    straight, _ = seated_mm(world)
    held, gap_mm = seated_mm(world, f"at 0 s: room {fault}")
    assert held - straight == pytest.approx(off_mm, abs=0.01)
    assert gap_mm == pytest.approx(0.0, abs=1e-6)
    changed = sample_instrument(world, TrueGuide(world), "T1", STOP_MM, 0)
    off = in_guide_mm(world, changed.tip_mm) - in_guide_mm(world, by_hand.tip_mm)
    assert off == pytest.approx(off_mm, abs=0.01)  # longer, it also leaves the bore's axis a little farther


def test_a_loose_instrument_leans_within_the_play_of_the_bore_and_slips_back_from_its_stop(
    world: World,
) -> None:
    bore = world.scene.mount.guide
    off, gap_mm = seated_mm(world, "at 0 s: room loose instrument 0.5 0 0 mm 0 deg")
    assert off[0] == pytest.approx(bore.play_mm / 2.0)
    assert gap_mm == pytest.approx(0.0, abs=1e-6)
    off, gap_mm = seated_mm(world, "at 0 s: room loose instrument 0 0 -0.3 mm 0 deg")
    assert (off[2], gap_mm) == pytest.approx((STOP_MM - 0.3 - bore.bore_mm - bore.reach_mm, 0.3), abs=1e-6)
    tilted, _ = seated_mm(world, "at 0 s: room loose instrument 0 0 0 mm 0.3 deg")
    assert abs(tilted[1]) > bore.play_mm / 2.0  # it leans on both ends of the bore
    with raises(STAND_NOT_READY, match="binds"):
        seated_mm(world, "at 0 s: room loose instrument 1.2 0 0 mm 0 deg")


def test_without_an_assistant_there_is_no_clamp_and_no_second_cart() -> None:
    alone = draw_scene("mini")
    for fault in ("loose instrument 0 0 1 mm 0 deg", "turn assistant_cart 0 0 1 deg"):
        (parsed,) = parse_faults(f"at 0 s: room {fault}")
        check_faults([parsed], add_assistant(alone))
        with pytest.raises(Exception, match="expected a scene with two arms"):
            check_faults([parsed], alone)

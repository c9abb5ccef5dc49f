"""The URDF of each arm, read by Pinocchio, moves as the arm does, with its bodies where they are checked."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest

from ronna_hw.arm.catalogue import ARMS, find_arm
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Part, Surroundings
from ronna_hw.arm.clearance.live_watch import PlacedBodies
from ronna_hw.arm.errors import UnknownArm
from ronna_hw.arm.urdf import write_urdf
from ronna_hw.vectors import joint_vector

NEEDLE = Part("needle", Capsule((0.0, 0.0, 10.0), (30.0, 40.0, 110.0), 3.0))


def postures(name: str) -> np.ndarray:
    arm = find_arm(name).kinematics
    low, high = np.array(arm.lower_rad), np.array(arm.upper_rad)
    return np.random.default_rng(5).uniform(np.maximum(low, -np.pi), np.minimum(high, np.pi), (20, len(low)))


@pytest.mark.parametrize("name", list(ARMS))
def test_the_flange_is_where_the_arm_has_it(name: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(write_urdf(find_arm(name)))
    model = pinocchio.buildModelFromUrdf(str(file))
    data = model.createData()
    kinematics = find_arm(name).kinematics
    assert model.lowerPositionLimit == pytest.approx(np.array(kinematics.lower_rad))
    for q in postures(name):
        pinocchio.framesForwardKinematics(model, data, q)
        placed = data.oMf[model.getFrameId("flange")]
        expected = kinematics.flange_pose(joint_vector(q.tolist()))
        assert 1000.0 * placed.translation == pytest.approx(expected.translation_mm, abs=1e-4)
        assert placed.rotation == pytest.approx(expected.rotation_matrix, abs=1e-7)


def test_joints_have_names_without_blanks() -> None:
    robot = ElementTree.fromstring(write_urdf(find_arm("ur5e")))
    names = [joint.attrib["name"] for joint in robot.iter("joint")]
    assert names[3] == "wrist_1"
    assert not [name for name in names if " " in name]


@pytest.mark.parametrize(("name", "meant"), [("UR5E", "ur5e"), ("ur6", "ur")])
def test_a_mistyped_arm_is_refused_with_the_one_that_was_meant(name: str, meant: str) -> None:
    with pytest.raises(UnknownArm) as refused:
        find_arm(name)
    assert f"Did you mean {meant}" in refused.value.advice


@pytest.mark.parametrize("name", list(ARMS))
def test_links_and_tool_are_drawn_where_motions_are_checked(name: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(write_urdf(find_arm(name), [NEEDLE]))
    model = pinocchio.buildModelFromUrdf(str(file))
    shapes = pinocchio.buildGeomFromUrdf(model, str(file), pinocchio.GeometryType.COLLISION)
    data, placed = model.createData(), shapes.createData()
    kinematics = find_arm(name).kinematics
    bodies = Bodies(kinematics, Surroundings(tool=(NEEDLE,)))
    spheres = [k for k, one in enumerate(shapes.geometryObjects) if "Sphere" in type(one.geometry).__name__]
    for q in postures(name)[:3]:
        pinocchio.updateGeometryPlacements(model, data, shapes, placed, q)
        drawn = np.array([1000.0 * placed.oMg[k].translation for k in spheres])
        for segment in PlacedBodies(bodies, joint_vector(q.tolist())):
            for end in segment:
                assert np.linalg.norm(drawn - np.array(end), axis=1).min() < 1e-3

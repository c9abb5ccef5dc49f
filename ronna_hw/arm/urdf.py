"""URDF of an arm of the catalogue, with the capsules that its motions are checked against.

Lengths in m, angles in rad; joints are named as the arm names its axes, with underscores for blanks, which
readers of URDF do not accept everywhere. The chain is the nominal one: a calibrated arm deviates from it by
millimetres. There are no masses and no efforts: it serves kinematics and collision checks, not dynamics.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import atan2, dist, hypot
from xml.etree import ElementTree

from ronna_hw.arm.catalogue import ArmDescription
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Part, Surroundings
from ronna_hw.arm.kinematics import COLUMN_NAME
from ronna_hw.arm.pose import Rotation9

M_PER_MM = 1e-3
BASE, FLANGE = "base_link", "flange"
NO_EFFORT = "0"  # not stated by the vendors in a form that fits; URDF asks for one


def write_urdf(arm: ArmDescription, tool: Sequence[Part] = ()) -> str:
    """Return the URDF of an arm with the parts of its tool, which are in the frame of the flange."""
    kinematics = arm.kinematics
    chain, bodies = kinematics.chain, Bodies(kinematics, Surroundings(tool=tuple(tool)))
    names = [BASE, *(f"link_{number}" for number in range(1, len(chain.joints) + 1))]
    parts: dict[str, list[Part]] = {name: [] for name in (*names, FLANGE)}
    parts[BASE].append(Part(COLUMN_NAME, bodies.fixed[0]))
    radii_mm = bodies.moving_radii_mm[: len(kinematics.links)]  # those of the tool's parts follow
    for link, radius_mm in zip(kinematics.links, radii_mm, strict=True):
        parts[names[1 + link.joint]].append(Part(link.name, Capsule(link.start_mm, link.end_mm, radius_mm)))
    parts[FLANGE] += tool
    robot = ElementTree.Element("robot", name=arm.name)
    for name in (*names, FLANGE):
        _add_link(robot, name, parts[name])
    offsets = (chain.base_mm, *(joint.to_next_mm for joint in chain.joints))
    for number, ((parent, child), joint) in enumerate(zip(pairwise(names), chain.joints, strict=True)):
        name = joint_name(kinematics.axis_names[number])
        one = _add_joint(robot, name, "revolute", parent, child, offsets[number])
        ElementTree.SubElement(one, "axis", xyz=_numbers(joint.axis))
        ElementTree.SubElement(
            one,
            "limit",
            lower=f"{kinematics.lower_rad[number]:.9g}",
            upper=f"{kinematics.upper_rad[number]:.9g}",
            velocity=f"{kinematics.full_speed_rad_s[number]:.9g}",
            effort=NO_EFFORT,
        )
    _add_joint(robot, "to_flange", "fixed", names[-1], FLANGE, offsets[-1], _rpy(chain.flange_rotation))
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def joint_name(axis: str) -> str:
    """Return the name in URDF of an axis."""
    return axis.replace(" ", "_")


def _add_link(robot: ElementTree.Element, name: str, parts: Sequence[Part]) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    for part_name, capsule, _ in parts:
        length_mm = dist(capsule.start_mm, capsule.end_mm)
        radius = f"{capsule.radius_mm * M_PER_MM:.9g}"
        for end_mm in (capsule.start_mm, capsule.end_mm):
            _add_shape(link, part_name, "sphere", end_mm, (0.0, 0.0, 0.0), radius=radius)
        if length_mm:
            x, y, z = ((e - s) / length_mm for s, e in zip(capsule.start_mm, capsule.end_mm, strict=True))
            middle = [(s + e) / 2.0 for s, e in zip(capsule.start_mm, capsule.end_mm, strict=True)]
            along = (0.0, atan2(hypot(x, y), z), atan2(y, x))
            length = f"{length_mm * M_PER_MM:.9g}"
            _add_shape(link, part_name, "cylinder", middle, along, radius=radius, length=length)


def _add_shape(
    link: ElementTree.Element,
    name: str,
    shape: str,
    at_mm: Sequence[float],
    rpy: Sequence[float],
    **sizes: str,
) -> None:
    for kind in ("visual", "collision"):
        one = ElementTree.SubElement(link, kind, name=name)
        ElementTree.SubElement(one, "origin", xyz=_metres(at_mm), rpy=_numbers(rpy))
        ElementTree.SubElement(ElementTree.SubElement(one, "geometry"), shape, sizes)


def _add_joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    at_mm: Sequence[float],
    rpy: Sequence[float] = (0.0, 0.0, 0.0),
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    ElementTree.SubElement(joint, "origin", xyz=_metres(at_mm), rpy=_numbers(rpy))
    return joint


def _rpy(rotation: Rotation9) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in rad: rotations about the fixed x, y and z axes, in this order."""
    r = rotation
    return atan2(r[7], r[8]), atan2(-r[6], hypot(r[7], r[8])), atan2(r[3], r[0])


def _metres(point_mm: Sequence[float]) -> str:
    return _numbers([value * M_PER_MM for value in point_mm])


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)

"""Arms of parameter set S, drawn like those of the simulated theatre, many at once.

The formulas are those of the simulator's true arm, implemented a second time for arrays: a test compares the
two. Every arm is drawn from the seed and its own number.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.arm.deviations import FLANK_SHARE
from ronna_hw.arm.kinematics import Chain
from ronna_hw.arm.kr6_r900 import kr6_r900
from sim.world.scene.as_built import TOOL_IN_FLANGE_MM, draw_arm, draw_mount
from sim.world.scene.model import ArmTruth
from studies.accuracy.turning import Components, mapped, shifted, turned

Array = NDArray[np.float64]

ARMS_KEY = 4  # of the random numbers: arms are independent of everything else drawn from a seed
UPPER_ARM, FOREARM = 1, 3  # links between A2 and A3, between A4 and the wrist


class Source(StrEnum):
    """A source of target error."""

    TOOL = "tool frame"
    LINKS = "links and joint offsets"
    JOINTS = "harmonics and sag"
    BACKLASH = "backlash"
    CT = "CT"
    REST = "servo and repeatability"


@dataclass(frozen=True)
class RandomArms:
    """Errors of `a` arms with six joints each. Millimetres and radians."""

    chain: Chain
    link_translation_mm: Array  # (a, 6, 3)
    link_rotation: Array  # (a, 6, 3, 3)
    joint_offset_rad: Array  # (a, 6)
    harmonics_rad: Array  # (a, 2, 6) once and twice per turn
    phases_rad: Array  # (a, 2, 6)
    sag_rad: Array  # (a, 2) of A2 and A3 at full stretch
    backlash_rad: Array  # (a, 6) the full backlash
    tool_error_mm: Array  # (a, 3) in the flange frame
    repeatability_mm: float  # per axis, at rest

    @classmethod
    def draw(cls, seed: int, numbers: Iterable[int]) -> Self:
        """The arms with these numbers."""
        return cls.of([drawn_arm(seed, number) for number in numbers])

    @classmethod
    def of(cls, drawn: list[tuple[ArmTruth, Array]]) -> Self:
        """From true arms, each with its tool error (3,) mm."""
        truths = [truth for truth, _ in drawn]
        links = [truth.links for truth in truths]
        turns = np.array([[link.rotation_rad for link in arm] for arm in links])
        return cls(
            chain=kr6_r900(truths[0].variant).chain,
            link_translation_mm=np.array([[link.translation_mm for link in arm] for arm in links]),
            link_rotation=Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(-1, 6, 3, 3),
            joint_offset_rad=np.array([truth.joint_offset_rad for truth in truths]),
            harmonics_rad=np.array([(truth.harmonic_1_rad, truth.harmonic_2_rad) for truth in truths]),
            phases_rad=np.array([(one.harmonic_1_phase_rad, one.harmonic_2_phase_rad) for one in truths]),
            sag_rad=np.array([truth.sag_rad for truth in truths]),
            backlash_rad=np.array([truth.backlash_rad for truth in truths]),
            tool_error_mm=np.array([error for _, error in drawn]),
            repeatability_mm=truths[0].repeatability_mm,
        )

    def __len__(self) -> int:
        return len(self.tool_error_mm)

    def only(self, source: Source) -> RandomArms:
        """The same arms with the errors of one source only; CT and servo errors are not the arm's."""
        no_turns = np.broadcast_to(np.eye(3), self.link_rotation.shape)
        return replace(
            self,
            tool_error_mm=self.tool_error_mm * (source is Source.TOOL),
            link_translation_mm=self.link_translation_mm * (source is Source.LINKS),
            link_rotation=self.link_rotation if source is Source.LINKS else no_turns,
            joint_offset_rad=self.joint_offset_rad * (source is Source.LINKS),
            harmonics_rad=self.harmonics_rad * (source is Source.JOINTS),
            sag_rad=self.sag_rad * (source is Source.JOINTS),
            backlash_rad=self.backlash_rad * (source is Source.BACKLASH),
            repeatability_mm=self.repeatability_mm * (source is Source.REST),
        )

    def tool_points_mm(self, joints_rad: Array, flanks: Array) -> Array:
        """True position of the tool, (a, p, 3) mm in the robot frame, without the repeatability error.

        Encoder angles (a, p, 6); `flanks` (a, p, 6) give the side of its backlash on which each joint rests.
        """
        angles = self._acting(joints_rad, flanks)
        shape = joints_rad.shape[:-1]
        tool = self.tool_error_mm + np.array(TOOL_IN_FLANGE_MM)
        x, y, z = (np.broadcast_to(part[:, None], shape) for part in tool.T)
        point: Components = (x, y, z)
        last = len(self.chain.joints) - 1
        point = mapped(np.reshape(self.chain.flange_rotation, (3, 3)), self._beyond(last, point))
        for number in reversed(range(last + 1)):
            joint = self.chain.joints[number]
            if number < last:
                point = self._beyond(number, point)
            point = turned(joint, angles[..., number], shifted(point, joint.to_next_mm))
        return np.stack(shifted(point, self.chain.base_mm), axis=-1)

    def _beyond(self, link: int, point: Components) -> Components:
        """A point beyond a link's end, displaced by the link's error, in the frame before the link."""
        return shifted(
            mapped(self.link_rotation[:, None, link], point), self.link_translation_mm[:, None, link]
        )

    def _acting(self, encoders_rad: Array, flanks: Array) -> Array:
        angles = encoders_rad + self.joint_offset_rad[:, None]
        for place, order in enumerate((1, 2)):
            size, phase = self.harmonics_rad[:, None, place], self.phases_rad[:, None, place]
            angles = angles + size * np.sin(order * encoders_rad + phase)
        angles = angles + FLANK_SHARE * self.backlash_rad[:, None] * flanks
        upper_mm = self.chain.joints[UPPER_ARM].to_next_mm[0]
        fore_mm = self.chain.joints[FOREARM].to_next_mm[0]
        fore = np.cos(encoders_rad[..., 1] + encoders_rad[..., 2])
        stretch = (upper_mm * np.cos(encoders_rad[..., 1]) + fore_mm * fore) / (upper_mm + fore_mm)
        angles[..., 1] += self.sag_rad[:, None, 0] * stretch
        angles[..., 2] += self.sag_rad[:, None, 1] * fore
        return np.asarray(angles)


def drawn_arm(seed: int, number: int) -> tuple[ArmTruth, Array]:
    """The true arm with this number, and its tool error (3,) mm."""
    random = np.random.default_rng(np.random.SeedSequence([seed, ARMS_KEY, number]))
    truth, mount = draw_arm(random), draw_mount(random)
    return truth, np.subtract(mount.flange_from_tool_true.translation_mm, TOOL_IN_FLANGE_MM)

"""Use of a proposed cart position in a case, and the cart's deviation from it."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, ValidationError
from scipy.spatial.transform import RigidTransform

from procedures.planning.cart_place import CartMove
from procedures.planning.errors import PLACE_UNFIT
from ronna_hw.arm.pose import Pose
from ronna_hw.bounded_input import InputRefused, read_json_bytes
from ronna_hw.calibration import Strict
from ronna_hw.frames import Frame, Transform
from ronna_hw.mistakes import describe_mistakes

LARGEST_FILE_BYTES = 4_000_000  # a map of maximum extent has some 18,000 squares and nodes
MOST_VALUES = 400_000
FURTHEST_MM = 10_000.0  # of any position in the room
Coordinate = Annotated[float, Field(ge=-FURTHEST_MM, le=FURTHEST_MM)]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Turn = Annotated[float, Field(ge=0.0, le=180.0)]
UNTURNED_DEG = 0.5  # below the tracker's resolution: 0.35 mm on spheres 80 mm apart, twice
TURNED_SHARE = 0.5  # of an unrotated cart's tolerance, at which rotations are tried


@dataclass(frozen=True)
class ProposalDeviation:
    """Deviation of the cart from its proposed position: x and y in the assumed $ROBROOT, and rotation.

    `head_mm` and `head_deg` are deviations that a cart on the floor cannot cause: the head
    is higher, or tilted.
    """

    x_mm: float
    y_mm: float
    turned_deg: float
    head_mm: float
    head_deg: float

    @property
    def off_mm(self) -> float:
        """Distance from the proposed position."""
        return math.hypot(self.x_mm, self.y_mm)


class ProposedPlace(Strict):
    """Fields of `place.json` used by a case. The map is ignored."""

    model_config = ConfigDict(extra="ignore")

    series_instance_uid: str = Field(description="DICOM UID of the CT series that it was made for.")
    assumed_robot_from_ct: tuple[Coordinate, Coordinate, Coordinate, Degrees, Degrees, Degrees] = Field(
        description="X Y Z A B C in mm and deg, at the assumed position."
    )
    best_mm: tuple[Coordinate, Coordinate] = Field(
        description="Proposed position, x and y in the assumed $ROBROOT."
    )
    turned_deg: Degrees = Field(description="Rotation of the cart there.")
    free_mm: float = Field(ge=0.0, le=FURTHEST_MM, description="Position tolerance of the cart.")
    turns_deg: tuple[Turn, Turn] = Field(description="Rotation tolerance, negative and positive.")

    def drift(self, robot_from_ct: Transform) -> ProposalDeviation:
        """Return the cart's deviation, given the pose ROBOT <- CT at its actual position."""
        # the current base in the base assumed then
        moved = self._assumed * robot_from_ct.rigid.inv()
        x_mm, y_mm, z_mm = moved.translation.tolist()
        axes = moved.rotation.as_matrix()
        turned_deg = math.degrees(math.atan2(axes[1, 0], axes[0, 0]))
        return ProposalDeviation(
            x_mm=x_mm - self.best_mm[0],
            y_mm=y_mm - self.best_mm[1],
            turned_deg=(turned_deg - self.turned_deg + 180.0) % 360.0 - 180.0,
            head_mm=-z_mm,
            head_deg=math.degrees(math.acos(float(np.clip(axes[2, 2], -1.0, 1.0)))),
        )

    @property
    def robot_from_ct(self) -> tuple[float, float, float, float, float, float]:
        """Pose of the CT in $ROBROOT with the cart where it is proposed: X Y Z A B C in mm and deg."""
        moved = CartMove(*self.best_mm, math.radians(self.turned_deg)).to_cart_frame(self._assumed)
        return Pose.from_matrix(moved.as_matrix().tolist()).to_kuka()

    def allows(self, drift: ProposalDeviation) -> bool:
        """Return whether a deviation is within the position tolerance and the examined rotations."""
        most_negative_deg, most_positive_deg = self.turns_deg
        turned = abs(drift.turned_deg) > UNTURNED_DEG
        free_mm = self.free_mm * TURNED_SHARE if turned else self.free_mm
        return drift.off_mm <= free_mm and (
            not turned or -most_negative_deg <= drift.turned_deg <= most_positive_deg
        )

    @property
    def _assumed(self) -> RigidTransform:
        assumed = Pose.from_kuka(*self.assumed_robot_from_ct)
        return Transform.of(
            Frame.ROBOT, Frame.CT, translation_mm=assumed.position_mm, quaternion_wxyz=assumed.quaternion()
        ).rigid


@dataclass(frozen=True)
class PlaceFile:
    """A cart position proposal and the SHA-256 of its file."""

    place: ProposedPlace
    sha256: str


def read_place(path: Path) -> PlaceFile | None:
    """Read a proposal, or return None if the file does not exist. Raises PLAN-022."""
    try:
        content = read_json_bytes(path, LARGEST_FILE_BYTES, MOST_VALUES)
        return PlaceFile(ProposedPlace.model_validate_json(content), hashlib.sha256(content).hexdigest())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise PLACE_UNFIT(f"cannot read {path.name}: {error.strerror}") from error
    except InputRefused as error:
        raise PLACE_UNFIT(f"{path.name}: {error.summary}") from error
    except ValidationError as error:
        raise PLACE_UNFIT(f"{path.name}: " + "; ".join(describe_mistakes(error))) from error

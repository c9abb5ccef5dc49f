"""Plain tuples of numbers shared by readings, motions and arm kinematics."""

from collections.abc import Iterable

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # scalar first, unit
JointVector = tuple[float, ...]  # one number per joint, from the base outwards; angles in radians


def vector3(values: Iterable[float]) -> Vector3:
    """Convert to a tuple of three floats; raises ValueError for another count."""
    x, y, z = values
    return (float(x), float(y), float(z))


def joint_vector(values: Iterable[float]) -> JointVector:
    """Convert to a tuple of numbers, one per joint from the base outwards."""
    return tuple(values)

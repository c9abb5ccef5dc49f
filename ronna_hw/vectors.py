"""Plain tuples of numbers shared by readings, motions and arm kinematics."""

from collections.abc import Iterable

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # scalar first, unit
JointVector = tuple[float, float, float, float, float, float]  # from the base outwards, radians


def vector3(values: Iterable[float]) -> Vector3:
    """Convert to a tuple of three floats; raises ValueError for another count."""
    x, y, z = values
    return (float(x), float(y), float(z))


def joint_vector(values: Iterable[float]) -> JointVector:
    """Convert to a tuple of six numbers, from the base outwards; raises ValueError for another count."""
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)

"""Plain tuples of numbers that readings, motions and the arm's mathematics share."""

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # scalar first, unit
JointVector = tuple[float, float, float, float, float, float]  # from the base outwards, radians

"""The arm: nominal kinematics, inverse kinematics, jerk-limited motion, limits, monitor."""

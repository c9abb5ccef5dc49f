"""The arm: nominal and true geometry, drives, inverse kinematics."""

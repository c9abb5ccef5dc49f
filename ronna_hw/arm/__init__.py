"""The arm: kinematics behind a neutral interface, motion, clearance, and the independent monitor."""

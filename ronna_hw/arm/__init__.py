"""Robot arm: vendor-neutral kinematics, motion, clearance and independent monitoring."""

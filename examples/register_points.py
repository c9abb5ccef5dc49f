"""Pair two unordered point sets with an outlier, register them, and predict the error at a target.

Run it:  python examples/register_points.py
"""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration import match, register

# Five spheres in the CT (mm, LPS), and what a tracker saw: another order and frame, noise, one reflection.
ct_mm = np.array([[62, -41, 58], [-55, -38, 63], [8, 85, 47], [-70, 30, 20], [66, 42, 5]], dtype=float)
room_from_ct = RigidTransform.from_components(
    [120, -300, -1800], Rotation.from_euler("ZYX", [1.0, 0.3, -0.6])
)
noise = np.random.default_rng(5).normal(size=(5, 3)) * 0.25
tracker_mm = np.vstack([room_from_ct.apply(ct_mm) + noise, [[40.0, -120.0, -1650.0]]])[[3, 5, 0, 4, 2, 1]]
target_mm = [5.0, -12.0, 10.0]

found = match(ct_mm, tracker_mm, sigma_image_mm=0.05, sigma_physical_mm=0.25, expected=5)
print(f"correspondence: {found.status} ({found.reason})")
for sphere, reading in found.pairs:
    print(f"  CT sphere {sphere} is tracker reading {reading}")
print(f"  unmatched tracker readings: {list(found.unmatched_physical)}")

fit = register(ct_mm[found.pairs[:, 0]], tracker_mm[found.pairs[:, 1]])
fit.require_sound()
predicted = fit.predict_tre(target_mm, fle_mm=0.25 * np.sqrt(3))
error_mm = np.linalg.norm(fit.transform.apply(target_mm) - room_from_ct.apply(target_mm))
print(f"residual of the fiducials (FRE, not an accuracy): {fit.fre_mm:.3f} mm")
print(
    f"predicted error at the target: {predicted.rms_mm[0]:.3f} mm rms, {predicted.limit_mm[0]:.3f} mm at 95 %"
)
print(f"true error at the target: {error_mm:.3f} mm")

"""The simulated head CT: a DICOM series, a plan on it, and the truth.

Not simulated: gantry tilt, helical artefacts, beam hardening, movement of the patient, errors of the
scanner's scale and table, roundness of the spheres, anatomy beyond ellipsoids. Streaks are lobes that fade
with the distance, not a reconstruction; those of posts exist in the families `posts` and `streaks` only.
"""

"""The simulated head CT: a DICOM series, a plan on it, and the truth.

Faults of real scanners are options (`scanner/faults.py`). Not simulated: helical artefacts, roundness of the
spheres, anatomy beyond ellipsoids. Streaks are lobes that fade with the distance or straight bands, not a
reconstruction; those of posts exist in the families `posts`, `bands`, `streaks` and `rays` only.
"""

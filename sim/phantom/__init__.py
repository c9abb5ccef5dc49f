"""Simulated head CT: a DICOM series, a plan for it, and its ground truth.

Faults of real scanners are options (`scanner/faults.py`). Not simulated: helical artefacts, spheres out of
round, anatomy beyond ellipsoids. Streaks are lobes that fade with distance, or straight bands, not a
reconstruction; streaks from posts exist only in the families `posts`, `bands`, `streaks` and `rays`.
"""

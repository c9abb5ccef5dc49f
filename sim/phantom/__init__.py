"""The simulated head CT: a DICOM series, a plan on it, and the truth.

Not simulated: gantry tilt, helical artefacts, beam hardening, streaks from the posts of the markers
(fillings make them), movement of the patient, errors of the scanner's scale and table, anatomy beyond
ellipsoids.
"""

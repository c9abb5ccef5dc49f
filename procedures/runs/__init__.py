"""Open, resume and finish runs: one lifecycle for cases, calibrations and measurements."""

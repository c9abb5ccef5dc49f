"""Opening, resuming and finishing runs, with one lifecycle for cases, calibrations and measurements."""

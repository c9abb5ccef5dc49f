"""The steps of the procedures, one module each: the clinical ones and those of calibrations."""

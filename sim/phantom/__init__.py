"""A phantom head as a DICOM CT series, with its plan and its truth."""

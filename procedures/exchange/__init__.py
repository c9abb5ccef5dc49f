"""Export of results for other programs: DICOM registration and fiducials, Slicer markups, CSV."""

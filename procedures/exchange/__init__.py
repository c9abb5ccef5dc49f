"""Export of results in formats of other programs: DICOM registration and fiducials, Slicer markups, CSV."""

"""Results in the forms that other programs read: DICOM registration and fiducials, Slicer markups, CSV."""

"""DICOM files of a CT series: headers, geometry and pixels, each checked where it is read."""

"""DICOM files of a CT series: headers, geometry and pixels, each validated as it is read."""

"""DICOM files of a CT series: headers, geometry and pixels, validated on reading."""

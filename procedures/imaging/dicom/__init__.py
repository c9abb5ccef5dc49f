"""Reader of DICOM CT series: headers, geometry and pixels, validated on reading."""

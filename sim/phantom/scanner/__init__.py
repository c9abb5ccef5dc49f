"""How it is scanned: voxel grid, blur, noise, and the DICOM series."""

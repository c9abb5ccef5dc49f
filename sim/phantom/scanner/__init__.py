"""Simulated CT scanner: voxel grid, blur, noise and DICOM series."""

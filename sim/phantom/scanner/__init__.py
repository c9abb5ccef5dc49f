"""Simulated CT scanner: voxel grid, blur, noise, and the DICOM series."""

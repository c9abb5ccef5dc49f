"""DICOM volumes and the localization of spheres in them."""

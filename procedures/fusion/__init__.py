"""Fusion of another series, such as an MR, with the CT: rigid registration, its error, and pictures of it."""

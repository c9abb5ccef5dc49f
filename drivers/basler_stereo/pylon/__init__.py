"""Stereo driver based on the vendor library pypylon, an optional extra."""

"""Stereo pair through the vendor's library pypylon, an optional extra."""

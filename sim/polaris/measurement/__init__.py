"""Measurement: from visible markers to a frame of tool poses and strays."""

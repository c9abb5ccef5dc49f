"""Measurement: from the visible markers to one frame of tool poses and strays."""

"""Tracking: requests, replies, frame clock and readings."""

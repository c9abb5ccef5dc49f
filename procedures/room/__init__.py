"""Estimate of where everything in the room is, with covariance, and of what each look adds to it."""

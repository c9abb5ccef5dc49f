"""Estimators of one sphere's centre: its edge along rays, a blurred ball in the voxels, a ball with its
streaks.
"""

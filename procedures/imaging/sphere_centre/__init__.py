"""Estimators of one sphere's centre: its edge along rays, and a blurred ball without or with its streaks."""

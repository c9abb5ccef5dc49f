"""Correspondence, rigid fit and the prediction of its error."""

"""Correspondence methods, by the thesis' protocols and ours."""

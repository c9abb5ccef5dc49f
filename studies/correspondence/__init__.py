"""Comparison of correspondence methods, by the thesis' protocols and our own."""

"""Correspondence methods, compared by the thesis' protocols and ours."""

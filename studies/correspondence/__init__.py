"""Do correspondence methods find the right pairs? The thesis' protocols, and ours."""

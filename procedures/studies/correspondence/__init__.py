"""Do methods of correspondence find the right pairs? The thesis' protocols, and ours."""

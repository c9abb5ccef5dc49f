"""Monte-Carlo studies next to the thesis' figures, split into units with their own seeds."""

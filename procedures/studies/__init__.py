"""Monte-Carlo studies beside the thesis' figures: cut into units with seeds of their own, run anywhere."""

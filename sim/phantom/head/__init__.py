"""What is scanned: the head in layers, its anatomy, the markers and what lies around them."""

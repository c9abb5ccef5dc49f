"""A sphere in an image, in a stereo pair, and the law that centres it."""

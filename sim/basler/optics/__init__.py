"""What a camera of the stereo head sees: spheres on posts, light, lens and sensor. Knows no network."""

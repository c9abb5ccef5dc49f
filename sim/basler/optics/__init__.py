"""Image formation in a stereo camera: spheres on posts, light, lens and sensor."""

"""The image of a stereo camera: spheres on posts, light, lens and sensor."""

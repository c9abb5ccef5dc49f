"""How well spheres are found in the CT: phantom families, and the thesis' protocol."""

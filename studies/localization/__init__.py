"""How well spheres are localized in the CT: phantom families, and the thesis' protocol."""

"""How well the sensors see a single marker: volume, noise, bias and phantoms."""

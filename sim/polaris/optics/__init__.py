"""How the sensors measure a single marker: volume, noise, bias and phantoms."""

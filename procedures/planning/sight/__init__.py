"""What stereo head and tracker see from where a plan puts them."""

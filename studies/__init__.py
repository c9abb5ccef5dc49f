"""Monte-Carlo studies compared with the thesis' figures, split into independently seeded units."""

"""Monte-Carlo studies, split into independently seeded units and compared with the thesis' figures."""

"""The simulated NDI Polaris Spectra: its own process, the unit's bytes, the theatre's scene.

Not simulated: wired and active tools and their commands, diagnostic mode, other faces than the first of a
tool, the minimum spread of its markers, warnings about tool geometry; spheres hidden behind the head or
behind each other, phantom markers and reflections; the line settings of a serial host (any rate is
understood; only a throttled line keeps to its rate), and a break on a pseudo-terminal, which carries none.
"""

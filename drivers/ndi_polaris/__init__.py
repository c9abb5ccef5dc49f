"""Driver for NDI Polaris optical trackers (Spectra, Vicra) over serial or TCP."""

from drivers.ndi_polaris.driver import PolarisTracker

__all__ = ["PolarisTracker"]

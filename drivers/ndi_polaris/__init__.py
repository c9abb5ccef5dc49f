"""NDI Polaris optical tracker (Spectra, Vicra) over serial or TCP."""

from drivers.ndi_polaris.driver import PolarisTracker

__all__ = ["PolarisTracker"]

"""dronemon: one drone keeps watch over several moving targets."""

__version__ = "0.1.0"

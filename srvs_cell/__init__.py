"""Cell controller for a stereo robot vision cell: one camera on a FANUC arm, planes matched, objects relocated."""

__version__ = "0.1.0"

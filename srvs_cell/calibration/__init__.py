"""Calibration: intrinsics, hand-eye, lateral path, error budget."""

"""Calibration tests."""

"""Calibrations in the languages of other programs: pure functions from a calibration to text."""

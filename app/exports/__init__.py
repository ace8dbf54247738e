"""Calibrations and effect sets in the languages of other programs: pure functions from them to text."""

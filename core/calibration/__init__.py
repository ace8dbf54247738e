"""Calibration: from runs made for it to the numbers that correct a sensor. One folder per sensor."""

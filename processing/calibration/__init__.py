"""Calibration: photographs of known things to colours, flats and lights that sessions carry."""

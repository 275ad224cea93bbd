"""Calibration targets, photographed in the stage."""

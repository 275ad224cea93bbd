"""Calibration shots: photographs by which sessions can be measured, and how long they hold."""

"""Cameras: one Protocol (camera.py), the gphoto2 driver, one supervised process a camera."""

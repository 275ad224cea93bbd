"""A camera: lens, sensor, RAW file, and what a laboratory does to them."""

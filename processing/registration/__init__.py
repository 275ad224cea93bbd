"""Registration: the template's topology laid onto a scan, by landmarks and non-rigid ICP."""

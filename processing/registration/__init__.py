"""Registration: the template's topology fitted to a scan, by landmarks and non-rigid ICP."""

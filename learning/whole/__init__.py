"""The `modern` network: light taken out of a whole face at low resolution, then its detail."""

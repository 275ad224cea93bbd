"""Inferred maps against captured ones: the published comparison on one's own people."""

"""Differentiable skin renderer in texture space, and the networks that use it."""

"""Procedural skin: pigments, relief, gloss, hair, on our own tile or any head's texture."""

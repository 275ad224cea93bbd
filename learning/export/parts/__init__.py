"""Eyeballs and a mouth's inside behind a fitted head's skin, and the openings to them."""

"""What a head needs behind its skin: eyeballs, lashes, a mouth's inside; and the openings to it."""

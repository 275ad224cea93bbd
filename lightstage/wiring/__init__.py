"""Which lamp is on which wire: light after light is lit, and an operator corrects the addresses."""

"""Which lamp is on which wire: lamp after lamp is lit, and an operator corrects the addresses."""

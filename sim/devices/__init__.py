"""Virtual lamps and cameras at the far ends of the wires, and how they misbehave."""

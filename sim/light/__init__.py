"""Light: the stage's lamps, environments and polarisers on a subject, by our own fast transport."""

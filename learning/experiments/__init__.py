"""The published experiments, and others, as many trainings of which one thing differs."""

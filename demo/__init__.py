"""The main job, end to end, on the simulated stage: the same commands that a user runs."""

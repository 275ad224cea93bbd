"""A light stage without the hardware: rendered people with known answers, virtual devices."""

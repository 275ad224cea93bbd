"""The second hand: Mitsuba's rays and reflectance, bounces, subsurface scattering."""

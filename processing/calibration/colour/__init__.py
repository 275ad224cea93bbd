"""What each camera's counts mean: flats, dark frames, the chart's colours."""

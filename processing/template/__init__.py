"""Templates that people already have: imported, checked, and maps carried between them."""

"""Templates that people already have: imported, looked through, and maps carried between them."""

"""Parts of the stage `refine`."""

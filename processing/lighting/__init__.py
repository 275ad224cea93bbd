"""What the stage sends to a point of skin, and what skin's surface does with it."""

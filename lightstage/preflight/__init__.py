"""What is made sure before a light goes on, and that it stays so."""

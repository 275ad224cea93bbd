"""People from elsewhere: textured scans and ICT Face Model Light, and their folder."""

"""One photograph, or several of one person, to a head: camera, shape, light and texture."""

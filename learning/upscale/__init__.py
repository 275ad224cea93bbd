"""Super-resolution of textures: the network, its pairs, training, use and score."""

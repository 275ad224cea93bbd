"""The four networks of AvatarMe: albedo, specular albedo, and both normals, one after the other."""

"""What passes between packages: session, processed folder, template, meshes, EXR."""

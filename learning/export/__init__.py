"""A head with maps, written for other programs: glTF, OBJ, maps with a recipe, USD, a web page."""

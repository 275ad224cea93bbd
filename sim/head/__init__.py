"""The parametric head: shape, identity, expressions, template."""

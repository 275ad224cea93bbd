"""Our own template, read once: what others are compared with."""

from __future__ import annotations

import functools

from lightstage.formats.template import Template, default_template_path, load_template


@functools.lru_cache(maxsize=1)
def own_template() -> Template:
    """The template that is committed as data."""
    return load_template(default_template_path())

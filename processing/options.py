"""Options that several commands have."""

from __future__ import annotations

import typer

from lightstage.formats.template import default_template_path

TemplatePath = typer.Option(
    default_template_path(),
    "--template",
    help="Template folder, whose topology and texture a registered head has.",
    show_default="the project's own",
)

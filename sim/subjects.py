"""People by name: the scanned head, or a parametric person of a seed."""

from __future__ import annotations

from sim.errors import SimError
from sim.scan import load_scan, scan_folder
from sim.subject import Subject


def load_subject(
    name: str, seed: int, expression: str = "neutral", texture_rows: int = 1536
) -> Subject:
    """A person ready to be lit.

    Args:
        name: ``lps`` for the scanned head; any other pseudonym is a parametric person.
        seed: of a parametric person; the scan is always the same.
        expression: such as ``neutral``; the scan has only that.
        texture_rows: rows of the textures.

    Raises:
        SimError: the scan is absent, or has no such expression.
    """
    if name != "lps":
        from sim.person import parametric_subject

        return parametric_subject(name, seed, expression, texture_rows)
    folder = scan_folder()
    if folder is None:
        raise SimError(
            "subject lps",
            found="no scan",
            expected="LeePerrySmith.glb in lps_head under LIGHTSTAGE_DATA or ../shared/data",
            hint="Use --subject parametric for a person that needs no data.",
        )
    if expression != "neutral":
        raise SimError("subject lps", field="expression", found=expression, expected="neutral")
    return load_scan(folder, texture_rows)

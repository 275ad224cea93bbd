"""People by name: the scanned head, ICT's heads, a subject folder, or a parametric person."""

from __future__ import annotations

from pathlib import Path

from lightstage.session import check_pseudonym
from sim.errors import SimError
from sim.people.subject import Subject
from sim.people.traits import Traits

SCAN, ICT = "lps", "ict"


def load_subject(
    name: str,
    seed: int,
    expression: str | None = None,
    texture_rows: int = 1536,
    traits: Traits | None = None,
) -> Subject:
    """A person ready to be lit.

    Args:
        name: ``lps`` for the scanned head; ``ict`` or ``ict-...`` for a head of ICT Face Model
            Light; a folder that holds a subject.json (or any path with a slash); any other
            pseudonym is a parametric person.
        seed: of a parametric person or of ICT's; scans and folders are always the same.
        expression: such as ``neutral``; scans and folders have one only. None for theirs, else
            neutral.
        texture_rows: rows of the textures; a folder's own stay as they are.
        traits: who a parametric or ICT's person is; None draws it from the seed.

    Raises:
        SimError: the data for it are absent, or it has no such expression.
    """
    if is_folder(name):
        from sim.scans.folder import load_subject_folder

        return _of_expression(load_subject_folder(Path(name)), expression, f"subject {name}")
    if name == SCAN:
        return _scan(expression, texture_rows)
    if name == ICT or name.startswith(f"{ICT}-"):
        return _ict(name, seed, expression or "neutral", texture_rows, traits)
    from sim.people.person import parametric_subject

    return parametric_subject(name, seed, expression or "neutral", texture_rows, traits)


def check_subject(name: str) -> None:
    """ConfigError when a name is neither a folder nor a pseudonym that a session may carry."""
    if not is_folder(name):
        check_pseudonym(name, "subject")


def is_folder(name: str) -> bool:
    """Whether a subject's name is a path: a folder with a subject, or anything with a slash."""
    return "/" in name or (Path(name) / "subject.json").is_file()


def _of_expression(subject: Subject, expression: str | None, where: str) -> Subject:
    if expression not in (None, subject.expression):
        raise SimError(
            where, field="expression", found=expression or "", expected=subject.expression
        )
    return subject


def _scan(expression: str | None, texture_rows: int) -> Subject:
    from sim.scans.lps import load_scan, scan_folder

    folder = scan_folder()
    if folder is None:
        raise SimError(
            "subject lps",
            found="no scan",
            expected="LeePerrySmith.glb in lps_head under LIGHTSTAGE_DATA or ../shared/data",
            hint="Use --subject parametric for a person that needs no data.",
        )
    if expression not in (None, "neutral"):
        raise SimError("subject lps", field="expression", found=expression, expected="neutral")
    return load_scan(folder, texture_rows)


def _ict(
    name: str, seed: int, expression: str, texture_rows: int, traits: Traits | None
) -> Subject:
    from sim.scans.ict import ict_folder
    from sim.scans.ict_subject import ict_subject

    folder = ict_folder()
    if folder is None:
        raise SimError(
            f"subject {name}",
            found="no ICT Face Model Light",
            expected="FaceXModel in ict_facekit under LIGHTSTAGE_DATA or ../shared/data",
            hint="Clone it, then make a folder for --subject with lightstage-sim import-ict.",
        )
    return ict_subject(name, folder, seed, expression, texture_rows, traits)

"""`lightstage-processing dataset add`, `remove`, `list`, `verify`: a store's scans one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from lightstage.commands import ConsentsOption, JsonFlag, finish, output_folder, progress_bar
from lightstage.counting import counted
from lightstage.errors import one_error
from lightstage.formats.access import group_of, limited_access
from processing.errors import ProcessingError

StorePath = typer.Option(..., "--store", help="The lab's store.", show_default=False)
StoreArgument = typer.Argument(..., help="The lab's store.", show_default=False)


def register(app: typer.Typer) -> None:
    """Add the commands to the group `dataset`."""
    app.command("add")(add_command)
    app.command("remove")(remove_command)
    app.command("list")(list_command)
    app.command("verify")(verify_command)
    app.command("forget")(forget_command)


def add_command(
    processed: list[Path] = typer.Argument(..., help="Processed folders.", show_default=False),
    store: Path = StorePath,
    consents: Path | None = ConsentsOption,
    as_json: bool = JsonFlag,
) -> None:
    """Add scans to a store; others may read it and add to it meanwhile."""
    from lightstage.errors import LightstageError
    from processing.dataset import NO_SCANS, add_scan, open_store, without_people_files

    folders, passed = without_people_files(processed)
    open_store(store, NO_SCANS)
    added, problems = [], []
    with limited_access(group_of([store])), progress_bar("dataset add") as progress:
        for index, root in enumerate(folders):
            try:
                added.append(add_scan(store, root, consents))
            except LightstageError as error:
                problems.append(error)
            progress(index + 1, len(folders))
    facts = {**_facts(store), "added": added, "passed_over": [str(path) for path in passed]}
    summary = f"{store}: {counted(len(added), 'scan')} added, {_store_counts(facts)}"
    if problems:
        print(summary)
        raise one_error(problems)
    finish(summary, facts, as_json)


def remove_command(
    scans: list[str] = typer.Argument(
        None, help="Scans, by the names that `dataset list` shows.", show_default=False
    ),
    store: Path = StorePath,
    subject: str | None = typer.Option(None, "--subject", help="All scans of this person."),
    as_json: bool = JsonFlag,
) -> None:
    """Take scans out of a store: off its list, then off the disk."""
    from processing.dataset import NO_SCANS, open_store, remove_scans

    names = list(scans or [])
    opened = open_store(store, NO_SCANS)
    if subject is not None:
        own = [scan.folder for scan in opened.scans if scan.subject == subject]
        if not own:
            raise ProcessingError(
                store,
                field="--subject",
                found=f"no scan of {subject!r}",
                expected="a person of the store",
                hint=f"`lightstage-processing dataset list {store}` shows them.",
            )
        names += own
    if not names:
        raise ProcessingError(
            "dataset remove", found="no scan", expected="names of scans, or --subject"
        )
    with limited_access(group_of([store])):
        gone = remove_scans(store, names)
    facts = {**_facts(store), "removed": [entry.folder for entry in gone]}
    finish(
        f"{store}: {counted(len(gone), 'scan')} removed, {_store_counts(facts)} left",
        facts,
        as_json,
    )


def list_command(store: Path = StoreArgument, as_json: bool = JsonFlag) -> None:
    """The scans of a store: name, person, expression, size, consent record."""
    from processing.dataset import NO_SCANS, open_store

    lines, rows = [], []
    for scan in open_store(store, NO_SCANS).scans:
        consent = "simulated" if scan.synthetic else scan.consent or "no consent record"
        size = f"{scan.rows} x {scan.columns}"
        lines.append("  ".join((scan.folder, scan.subject, scan.expression, size, consent)))
        rows.append(
            {
                "scan": scan.folder,
                "subject": scan.subject,
                "expression": scan.expression,
                "rows": scan.rows,
                "columns": scan.columns,
                "consent": scan.consent,
                "synthetic": scan.synthetic,
            }
        )
    facts = _facts(store)
    finish(
        "\n".join([*lines, f"{store}: {_store_counts(facts)}"]), {**facts, "list": rows}, as_json
    )


def verify_command(
    store: Path = typer.Argument(..., help="The lab's store, or a release.", show_default=False),
    as_json: bool = JsonFlag,
) -> None:
    """Hold every file of a store or of a release against the hash that was written with it."""
    from processing.dataset import is_release, open_store, verify_release, verify_store

    if is_release(store):
        with progress_bar("dataset verify") as progress:
            files = verify_release(store, progress)
        summary = f"{store}: a release, {counted(files, 'file')} as they were published"
        finish(summary, {"release": str(store), "files": files}, as_json)
        return
    open_store(store)
    with progress_bar("dataset verify") as progress:
        files, left = verify_store(store, progress)
    facts = {**_facts(store), "files": files, "left_by_killed_processes": left}
    summary = f"{store}: {_store_counts(facts)}, {counted(files, 'file')} as they were written"
    if left:
        summary += (
            f"; {', '.join(left[:5])}: of no scan, left by processes that were killed; "
            "`dataset add`, `remove` and `build` remove it"
        )
    finish(summary, facts, as_json)


def forget_command(
    subject: str = typer.Argument(..., help="The person's pseudonym.", show_default=False),
    folders: list[Path] = typer.Option(
        ..., "--in", help="Folder to search, with all below it; may be repeated."
    ),
    out: Path = output_folder("--out", help="Folder of the lab for the plan and the proof."),
    yes: bool = typer.Option(False, "--yes", help="Remove it; otherwise it is only listed."),
    as_json: bool = JsonFlag,
) -> None:
    """Take a person out of all folders of the lab, and write the proof."""
    import dataclasses

    from processing.dataset import forget as forgetting

    if not yes:
        with progress_bar("dataset forget") as progress:
            _, found = forgetting.search(subject, folders, out, False, progress)
        text = "\n".join(
            [*forgetting.found_in_words(found), "Nothing was removed; --yes removes it."]
        )
        finish(text, {"removed": False, **dataclasses.asdict(found)}, as_json)
        return
    with limited_access("nothing"), progress_bar("dataset forget") as progress:
        found, left, proof = forgetting.forget(subject, folders, out, progress)
    facts = {"removed": True, "proof": str(proof), "left": left, **dataclasses.asdict(found)}
    lines = forgetting.found_in_words(found)
    still = [
        f"still there: {path}"
        for path in sorted({path for paths in left.values() for path in paths})
    ]
    finish("\n".join([*lines, *still, f"{proof}: the proof"]), facts, as_json)
    if still:
        raise ProcessingError(
            proof,
            found=counted(
                len(still), "file that still shows or names", "files that still show or name"
            )
            + f" {subject}",
            expected="none",
            hint="Inspect each that is listed as still there, and remove it or its line by hand.",
        )


def _facts(store: Path) -> dict[str, Any]:
    from processing.dataset import open_store

    scans = open_store(store).scans
    return {
        "store": str(store),
        "scans": len(scans),
        "subjects": len({scan.subject for scan in scans}),
    }


def _store_counts(facts: dict[str, Any]) -> str:
    return f"{counted(facts['scans'], 'scan')} of {counted(facts['subjects'], 'subject')}"

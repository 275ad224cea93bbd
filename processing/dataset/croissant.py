"""A release's croissant.json: what it is, for machines, with the fields of responsible AI.

JSON-LD in the vocabulary of MLCommons, Croissant 1.0 with its extension RAI 1.0 [Akhtar2024].
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lightstage import __version__
from lightstage.formats.files import sha256_file, write_json
from processing.dataset import statements
from processing.dataset.about import About

CROISSANT = "croissant.json"
CONFORMS_TO = ("http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0")
_TERMS = (
    "citeAs column conformsTo equivalentProperty extract field fileObject fileProperty fileSet "
    "format includes isLiveDataset jsonPath key md5 parentField path recordSet references regex "
    "repeated replace samplingRate separator source subField transform"
)
CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    **{term: f"cr:{term}" for term in _TERMS.split()},
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
}
"""The context that the specification recommends: its appendix 1, and the RAI prefix."""
FORMATS = {
    ".json": "application/json",
    ".md": "text/markdown",
    ".tar": "application/x-tar",
    "zarr": "https://zarr-specs.readthedocs.io/en/latest/v3/core/index.html",
    "npy": "https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html",
}


def write_croissant(
    folder: Path, about: About, facts: Mapping[str, Any], form: str, day: str
) -> Path:
    """Write croissant.json beside the files of a release, all of which are there.

    Args:
        folder: of the release.
        about: the lab's statements.
        facts: of dataset.json.
        form: `zarr` or `webdataset`.
        day: of publication, YYYY-MM-DD.
    """
    return write_json(
        folder / CROISSANT,
        {
            "@context": CONTEXT,
            "@type": "sc:Dataset",
            "conformsTo": list(CONFORMS_TO),
            "name": about.name,
            "description": f"{statements.description(facts)} Read by {statements.READ_BY[form]}.",
            "license": about.license,
            "usageInfo": about.terms,
            "url": about.url,
            "version": about.version,
            "datePublished": day,
            "isLiveDataset": False,
            "creator": [{"@type": "sc:Organization", "name": name} for name in about.creators],
            "publisher": [{"@type": "sc:Organization", "name": name} for name in about.creators],
            "citeAs": about.cited_as,
            "keywords": ["skin", "reflectance", "albedo", "normals", "texture"],
            **_responsible(about, facts),
            "distribution": _distribution(folder, form),
        },
    )


def _responsible(about: About, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of responsible AI. No field states when people were captured, on purpose."""
    answers = about.answers
    kinds = []
    if facts["counts"]["subjects"] > facts["consent"]["subjects_simulated"]:
        kinds.append("Physical data collection")
    if facts["consent"]["subjects_simulated"]:
        kinds.append("Others")
    biases = [*statements.people(facts), *filter(str.strip, [answers.representation])]
    unsuited = filter(str.strip, [answers.unsuitable_uses])
    fields: dict[str, Any] = {
        "dataCollection": f"{statements.collection(facts)} {answers.recruitment}".strip(),
        "dataCollectionType": kinds,
        "dataCollectionRawData": statements.raw_data(facts),
        "dataCollectionMissingData": statements.missing(),
        "dataPreprocessingProtocol": [statements.preprocessing(facts)],
        "dataManipulationProtocol": statements.manipulation(facts),
        "dataImputationProtocol": "None: what was not measured is 0.",
        "dataAnnotationProtocol": "There are no labels.",
        "machineAnnotationTools": [f"lightstage {__version__}"],
        "dataBiases": biases,
        "dataLimitations": [*statements.limitations(facts), *unsuited],
        "dataUseCases": statements.uses(),
        "personalSensitiveInformation": statements.personal(facts),
        "dataReleaseMaintenancePlan": statements.maintenance(about),
    }
    if answers.impact.strip():
        fields["dataSocialImpact"] = answers.impact
    return {f"rai:{name}": value for name, value in fields.items()}


def _distribution(folder: Path, form: str) -> list[dict[str, Any]]:
    """The files: those at the top one by one with their hashes, arrays' parts as sets.

    checksums.json has the hash of every file, of this one too, and so is not listed here.
    """
    top = sorted(path for path in folder.iterdir() if path.is_file())
    files = [
        {
            "@type": "cr:FileObject",
            "@id": path.name,
            "name": path.name,
            "contentUrl": path.name,
            "contentSize": f"{path.stat().st_size} B",
            "encodingFormat": FORMATS[path.suffix],
            "sha256": sha256_file(path),
        }
        for path in top
    ]
    tars = [{"@id": path.name} for path in top if path.suffix == ".tar"]
    sets = []
    for name, what in statements.MAPS.items():
        of_form: dict[str, Any] = (
            {"encodingFormat": FORMATS["zarr"], "includes": f"{name}/**"}
            if form == "zarr"
            else {
                "encodingFormat": FORMATS["npy"],
                "includes": f"*.{name}.npy",
                "containedIn": tars,
            }
        )
        sets.append(
            {"@type": "cr:FileSet", "@id": name, "name": name, "description": what, **of_form}
        )
    return files + sets

"""JSON and TOML are parsed in one place: a new direct use of a parser fails here."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("lightstage", "processing", "learning", "sim", "demo")


def direct_reads(source: str) -> list[str]:
    """Calls of the JSON and TOML parsers in a file's source, and imports that hide them."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if (node.value.id, node.attr) in {
                *(("json", name) for name in ("load", "loads", "JSONDecoder")),
                *(("tomllib", name) for name in ("load", "loads")),
            }:
                found.append(f"{node.value.id}.{node.attr}, line {node.lineno}")
        elif isinstance(node, ast.Attribute) and node.attr == "model_validate_json":
            found.append(f"{node.attr}, line {node.lineno}")
        elif isinstance(node, ast.Import):
            names = [name.name for name in node.names if name.name == "tomllib" or name.asname]
            found += [f"import {name}" for name in names if name in ("json", "tomllib")]
        elif isinstance(node, ast.ImportFrom) and node.module in ("json", "tomllib"):
            found.append(f"from {node.module} import")
    return found


def test_no_file_of_the_packages_parses_json_or_toml_beside_the_reader():
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    assert len(files) > 300
    reader = ROOT / "lightstage/formats/values.py"
    # The guardian reads a pipe from its own parent, by the standard library alone.
    apart = (reader, ROOT / "lightstage/leds/guardian.py")
    assert all(direct_reads(path.read_text()) for path in apart)
    found = {
        str(path.relative_to(ROOT)): reads
        for path in files
        if path not in apart and (reads := direct_reads(path.read_text(encoding="utf-8")))
    }
    assert found == {}

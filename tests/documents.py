"""Commands and examples as the documents print them, and how a test runs them."""

from __future__ import annotations

import ast
import contextlib
import glob
import itertools
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from tests.programs import Ended, run_program

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "lightstage": "lightstage",
    "lightstage-sim": "sim",
    "lightstage-processing": "processing",
    "lightstage-learning": "learning",
}
"""Program name to the package that `python -m` runs."""


def blocks(text: str, language: str) -> list[str]:
    """Code blocks of a language ("" for plain ones), without their fences."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def table_code(text: str) -> list[str]:
    """Inline code in the tables' second column, where commands stand."""
    rows = [line.split("|") for line in text.splitlines() if line.startswith("|")]
    return [code for row in rows if len(row) > 3 for code in re.findall(r"`([^`]+)`", row[2])]


def commands(text: str) -> list[str]:
    """Commands of this project in plain code blocks and tables, joined where they go over lines."""
    lines = []
    for block in blocks(text, ""):
        lines += [line.split(" #")[0].strip() for line in block.replace("\\\n", " ").splitlines()]
    return [line for line in (*table_code(text), *lines) if line.split(" ")[0] in PACKAGES]


def options(command: str) -> set[str]:
    """Names of a command's options."""
    return {word.split("=")[0] for word in shlex.split(command) if word.startswith("--")}


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    found: set[str] = set()
    for heading in re.findall(r"^#{1,6} +(.*?) *$", without_code(text), re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        anchor = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        doubled = sum(1 for other in found if re.fullmatch(rf"{re.escape(anchor)}(-\d+)?", other))
        found.add(f"{anchor}-{doubled}" if doubled else anchor)
    return found


def without_code(text: str) -> str:
    """A page's text without its code blocks."""
    return re.sub(r"^( *)```.*?^\1```$", "", text, flags=re.MULTILINE | re.DOTALL)


def long_lines(text: str, most: int) -> list[str]:
    """Lines of prose with more characters: no code, table or picture, nor a line of one word."""
    lines = without_code(text).splitlines()
    prose = [line for line in lines if not line.lstrip().startswith(("|", "![")) and " " in line]
    return [line for line in prose if len(line) > most]


def broken_links(page: Path) -> list[str]:
    """Relative links and pictures of a page that meet no file, or no heading of it."""
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)\)", without_code(page.read_text())):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if not target.exists() or (anchor and anchor not in anchors(target.read_text())):
            broken.append(link)
    return broken


def missing_paths(text: str) -> list[str]:
    """Files and folders that a page names in code and that are not there.

    Names are from the root, or from `processing` where the section is that package's. In a table's
    row they may also be in a folder of its first cell, or in one around it.
    """
    missing = []
    inside = ROOT
    for line in without_code(text).splitlines():
        if line.startswith("## "):
            inside = ROOT / "processing" if line == "## Inside `processing`" else ROOT
        around = [ROOT, inside]
        if line.startswith("|"):
            for name in _paths(line.split("|")[1]):
                found = next((each for folder in around for each in folder.glob(name)), ROOT)
                around += [each for each in (found, *found.parents) if ROOT in each.parents]
        missing += [name for name in _paths(line) if not any(any(f.glob(name)) for f in around)]
    return missing


def _paths(text: str) -> list[str]:
    return re.findall(r"`([a-z0-9_./*]+(?:/|\.py|\.html))`", text)


def named_symbols(text: str) -> list[tuple[str, str]]:
    """File and name, wherever a page names both in code: "`FILE` (`NAME`, `NAME`)", "`NAME` and
    `NAME` (`FILE`)", or "`NAME` of `FILE`", or "in".
    """
    names, file = r"((?:`[\w.]+`(?:, | and | or )?)+)", r"`([\w/]+\.py)`"
    text = " ".join(text.split())
    after = re.findall(rf"{file} \({names}", text)
    before = re.findall(rf"{names} (?:\(|in |of ){file}", text)
    pairs = [*after, *((path, named) for named, path in before)]
    return [
        (path, name)
        for path, named in pairs
        for name in re.findall(r"`([\w.]+)`", named)
        if not name.endswith(".py")
    ]


def defined(path: Path) -> set[str]:
    """Names that a Python file defines at its head, and ``Class.name`` of its classes' members."""
    tree = ast.parse(path.read_text())
    names = _of(tree.body)
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{name}" for name in _of(node.body)}
    return names


def _of(body: Sequence[ast.stmt]) -> set[str]:
    names = set()
    for node in body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        targets = [node.target] if isinstance(node, ast.AnnAssign) else getattr(node, "targets", [])
        names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


def drawn_layers(text: str, heading: str) -> list[set[str]]:
    """The first drawing of layers after some words: each line's names, without its bracket."""
    drawing = text.split(heading)[1].split("```")[1]
    return [set(line.split("(")[0].split()) for line in drawing.strip("\n").splitlines()]


def run_as_written(command: str, folder: Path) -> Ended:
    """Run a command in a folder, in this process, with the words that a shell would give it."""
    program, *words = shlex.split(command)
    if syntax := set("|<>&;$`~") & set(command):
        raise ValueError(f"{command}: {syntax} mean something to a shell that is not done here")
    with contextlib.chdir(folder):
        expanded = [sorted(glob.glob(word)) if "*" in word else [word] for word in words]
        return run_program(PACKAGES[program], *itertools.chain(*expanded))

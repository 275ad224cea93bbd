"""The source code that a module can reach by its imports, read without running it."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]


def reachable_files(module: str, within: tuple[str, ...], root: Path = ROOT) -> list[Path]:
    """Files of this project that a module imports, directly or not, its own among them.

    Imports inside functions count, and each package's ``__init__`` on the way. A module that is
    imported by a name made at run time is not seen.

    Args:
        module: such as ``processing.decode.stage``.
        within: folders and files, relative to `root`, outside which no file is listed. Imports are
            followed through files outside them.
        root: holds the packages.

    Returns:
        Sorted paths.

    Raises:
        ModuleNotFoundError: `root` has no such module.
    """
    places = tuple(root / name for name in within)
    found: set[Path] = set()
    waiting = list(_files_of(module, root))
    if not waiting:
        raise ModuleNotFoundError(f"{root} holds no module {module}")
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            for name in _imported(path, root):
                waiting += _files_of(name, root)
    return sorted(p for p in found if any(p == place or place in p.parents for place in places))


@functools.cache
def _files_of(module: str, root: Path) -> tuple[Path, ...]:
    """A module's file and each ``__init__`` above it; empty where it is no module here."""
    path = root.joinpath(*module.split("."))
    own = path.with_suffix(".py") if path.with_suffix(".py").is_file() else path / "__init__.py"
    if not own.is_file():
        return ()
    above = [
        root.joinpath(*module.split(".")[:k], "__init__.py")
        for k in range(1, module.count(".") + 1)
    ]
    return (own, *(path for path in above if path.is_file()))


@functools.cache
def _imported(path: Path, root: Path) -> tuple[str, ...]:
    """Names of modules that a file imports; of ``from a import b`` both ``a`` and ``a.b``."""
    names: list[str] = []
    package = path.relative_to(root).parent.parts
    for node in _statements(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            base = ".".join(part for part in (above, node.module) if part)
            names += [base, *(f"{base}.{alias.name}" for alias in node.names)]
    return tuple(names)


def _statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements below a node: a fraction of what `ast.walk` goes through."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for inner in ("body", "handlers", "orelse", "finalbody", "cases"):
            waiting += getattr(node, inner, ())

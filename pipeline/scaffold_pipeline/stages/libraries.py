"""The libraries that can affect a stage's result, found from the imports in its sources."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from importlib.util import find_spec
from pathlib import Path

ENGINE = "scaffold_pipeline"
DISTRIBUTION = "scaffold-pipeline"
SHARED_PACKAGES = frozenset({"scaffold_geometry", "scaffold_stages"})
"""The package of this distribution that stages compute with; the engine itself computes no results."""

SHAPE_NO_OUTPUT = frozenset({"pydantic"})
"""Distributions that only check parameters."""

_Import = tuple[str, str]


def imported_libraries(module: str) -> frozenset[str]:
    """Return the distributions that the code of `module` imports, at the top of a file or inside a function.

    Imports are followed through the plug-in's own packages, packages without a distribution, and `scaffold_geometry`;
    a plug-in that uses the last also depends on `scaffold-pipeline`. The standard library and packages that are not
    installed are left out. Imports by a computed name are not found. The sources are parsed, not imported. Raises
    `SyntaxError` if a source cannot be parsed.
    """
    own = module.partition(".")[0]
    seen: set[str] = set()
    found: set[str] = set()
    todo = {module}
    while todo:
        at = todo.pop()
        seen.add(at)
        for imported in _imports_of(at):
            owners = _distributions_to_name(imported.partition(".")[0], own)
            found |= owners or set()
            todo |= {imported} - seen if owners is None else set()
    if own not in SHARED_PACKAGES and any(name.partition(".")[0] in SHARED_PACKAGES for name in seen):
        found.add(DISTRIBUTION)
    return frozenset(found - SHAPE_NO_OUTPUT)


def imports_in(statements: Iterable[ast.AST], package: str) -> Iterator[_Import]:
    """Yield (module, name) for each import among `statements` of a module in `package`; no name for a whole module.

    >>> list(imports_in(ast.parse("import numpy.linalg; from . import kernels").body, "plugin.fields"))
    [('numpy.linalg', ''), ('plugin.fields', 'kernels')]
    """
    for statement in statements:
        if isinstance(statement, ast.Import):
            yield from ((alias.name, "") for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) + 1 - statement.level] if statement.level else []
            module = ".".join([*above, *([statement.module] if statement.module else [])])
            yield from ((module, alias.name) for alias in statement.names)


def _distributions_to_name(top: str, own: str) -> set[str] | None:
    """Return the distributions of a package; None if its sources are to be followed instead."""
    if top == ENGINE or top in sys.stdlib_module_names:
        return set()
    if top == own or top in SHARED_PACKAGES:
        return None
    owners = _owners(top)
    return None if not owners or owners & _owners(own) else set(owners)


@cache
def _owners(top: str) -> frozenset[str]:
    """Return the distributions that install the package `top`, found by their files, or else by their name."""
    owners = _packages().get(top)
    if owners:
        return frozenset(owners)
    try:  # an editable install may list no files
        return frozenset({distribution(top).name})
    except PackageNotFoundError:
        return frozenset()


_packages = cache(packages_distributions)
"""Reads the lists of files of everything that is installed: 0.3 s for 130 distributions."""


def _imports_of(module: str) -> set[str]:
    """Return the modules that a module imports; none if it has no source, as a compiled module."""
    source = _source_of(module)
    if source is None:
        return set()
    is_package = source.name == "__init__.py"
    package = module if is_package else module.rpartition(".")[0]
    state = source.stat()
    pairs = _parse_imports(source, package, state.st_mtime_ns, state.st_size)
    return {f"{base}.{name}" if name and _source_of(f"{base}.{name}") else base for base, name in pairs}


@cache
def _parse_imports(source: Path, package: str, _modified: int, _size: int) -> frozenset[_Import]:
    return frozenset(imports_in(ast.walk(ast.parse(source.read_bytes(), str(source))), package))


def _source_of(module: str) -> Path | None:
    """Return the file of a module, found without loading it."""
    top, *rest = module.split(".")
    if top in sys.stdlib_module_names:
        return None
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):  # a module created at run time has no file
        return None
    if spec is None:
        return None
    if spec.submodule_search_locations is None:
        is_source = not rest and spec.origin is not None and spec.origin.endswith(".py")
        return Path(str(spec.origin)) if is_source else None
    places = [Path(place, *rest) for place in spec.submodule_search_locations]
    files = [file for place in places for file in (place / "__init__.py", place.with_suffix(".py")) if file.is_file()]
    return files[0] if files else None

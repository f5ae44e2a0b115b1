"""The reference in docs/api/: what the package and its rooms offer, from the docstrings. A warning is an error.

Run by `make docs`. pdoc warns of annotations that it cannot resolve and of public names that are not there.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import shutil
import sys
import warnings
from pathlib import Path
from types import ModuleType
from typing import get_type_hints

import pdoc

import flatsat_ros

_TARGET = Path(__file__).parent / "api"


def main() -> int:
    """Write the pages; return 0, or 1 after one line on stderr."""
    warnings.simplefilter("error")
    pdoc.render.configure(docformat="google", footer_text=f"flatsat_ros {flatsat_ros.__version__}")
    shutil.rmtree(_TARGET, ignore_errors=True)
    found = pkgutil.walk_packages(flatsat_ros.__path__, "flatsat_ros.")
    rooms = [importlib.import_module(package.name) for package in found if package.ispkg]
    try:
        documented = [module.__name__ for module in (flatsat_ros, *rooms) if _prepare(module)]
        # with names to offer, a package's page lists none of what lies inside it
        listed = ", ".join(f"`{name}`" for name in documented[1:])
        flatsat_ros.__doc__ = f"{flatsat_ros.__doc__}\n\nThe rooms: {listed}."
        pdoc.pdoc(*documented, output_directory=_TARGET)
    except Warning as warning:
        print(f"make docs: {' '.join(str(warning).split())}", file=sys.stderr)
        return 1
    print(f"{len(documented)} pages in {_TARGET}")
    return 0


def _prepare(module: ModuleType) -> bool:
    """Import the public names of a module and tell whether there are any, so that a page is worth it."""
    for name in getattr(module, "__all__", []):
        value = getattr(module, name)
        if inspect.isclass(value) and issubclass(value, tuple):
            # a named tuple's own annotations are text that nobody can resolve: they have forgotten their module
            value.__new__.__annotations__ = get_type_hints(value)
    return bool(getattr(module, "__all__", []))


if __name__ == "__main__":
    sys.exit(main())

"""The configuration that the package ships: where it lies, and how a user's argument becomes a path.

No ROS is involved, so that it works before anything is sourced.
"""

from __future__ import annotations

import os
from pathlib import Path

from flatsat_ros.base.errors import FlatsatError, nearest_name, quoted
from flatsat_ros.base.files import check_regular, user_path


def config_path(name_or_path: str | os.PathLike[str], folder: str = "") -> Path:
    """Find a YAML file by the name it has in the package or by the user's own path.

    Args:
        name_or_path: `paper_experiment` is looked up in the packaged configuration; what contains a path separator or
            ends in `.yaml` is a path of the user's, relative to the working directory, `~` is the home folder.
        folder: sub-folder of the packaged configuration in which a name is looked up, for example `vehicles`.

    Returns:
        The path of a file that exists.

    Raises:
        FlatsatError: there is no such file, it is no regular one, or nobody has that home folder. Where nothing is
            found, the text lists the names that exist.
    """
    packaged = _config_folder() / folder
    name = os.fspath(name_or_path)
    names = sorted(file.stem for file in packaged.glob("*.yaml"))
    if "/" in name or name.endswith(".yaml"):
        path = user_path(name)
        try:
            check_regular(path)
        except FlatsatError as error:
            if os.path.lexists(path):
                raise
            missing = str(error)
        else:
            return path
    else:
        if name in names:
            return packaged / f"{name}.yaml"
        missing = f"there is no packaged configuration {quoted(name)}{nearest_name(name, names)}"
    raise FlatsatError(f"{missing}; packaged in {packaged}: {', '.join(names)}; or give the path of a .yaml file")


def is_packaged(name: str, folder: str = "") -> bool:
    """Tell whether there is a packaged configuration of that name, see `config_path`."""
    return (_config_folder() / folder / f"{name}.yaml").is_file()


def _config_folder() -> Path:
    """Folder config/ of the source tree (also behind a symlink or editable install), else of the share/ installed."""
    package = Path(__file__).resolve().parents[1]
    source = package.parent
    if (source / "package.xml").is_file():
        return source / "config"
    for prefix in package.parents:
        share = prefix / "share" / package.name
        if (share / "package.xml").is_file():
            return share / "config"
    raise FlatsatError(f"the configuration of flatsat_ros is missing: no share/{package.name} above {package}")

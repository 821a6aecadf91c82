"""Find the folders `templates`, `static` and `docs`, however the package was installed."""

from __future__ import annotations

from pathlib import Path

from webapp.errors import MissingPart

PACKAGE = Path(__file__).resolve().parent


def resource_folder(name: str, *, package: Path = PACKAGE) -> Path:
    """Return a folder with the package's own data.

    A wheel has the folders inside the package; in a source tree, and thus in an editable install, they are
    next to it.

    Args:
        name: `templates`, `static` or `docs`.
        package: Folder of the package.
    """
    for folder in (package / name, package.parent / name):
        if folder.is_dir():
            return folder
    raise MissingPart(
        f"the folder {name} of the program is missing",
        where=str(package),
        hint="reinstall experience-map",
    )

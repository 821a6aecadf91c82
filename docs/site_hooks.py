"""Hooks of the documentation site: pages from outside docs/, and links to them.

On a forge the README, the changelog and the format of a map are read where they are, and links are paths of
the working copy. On the site they are pages like the others.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
OUTSIDE = {
    "README.md": "README.md",
    "CHANGELOG.md": "CHANGELOG.md",
    "maps/FORMAT.md": "FORMAT.md",
    "LICENSE": "LICENSE",
}
"""Path in the working copy, and path on the site."""


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages from outside docs/."""
    for source, target in OUTSIDE.items():
        files.append(File.generated(config, target, abs_src_path=str(ROOT / source)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Change links between pages from paths of the working copy to paths of the site."""
    sources = {target: source for source, target in OUTSIDE.items()}
    folder = posixpath.dirname(sources.get(page.file.src_uri, f"docs/{page.file.src_uri}"))

    def moved(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[2]))
        return f"{match[1]}{OUTSIDE.get(target, target.removeprefix('docs/'))}{match[3]}"

    return re.sub(r"(\]\()(?![a-z]+:|#)([^)\s#]+)((?:#[^)]*)?\))", moved, markdown)

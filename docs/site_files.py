"""What the site is made of: the pages where they lie, and every file that one of them links to (mkdocs.yml).

Pages link to each other, to scripts, tests and results by paths in the project. The site has the same folders, so that
a link means the same there as on a code host, and no page is copied or changed for it.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
# any other file is put there as a text to be read: a browser would save a .sh, and run a .html
SHOWN = (".md", ".png")


def linked_from(path: str) -> list[str]:
    """Files of the project that a page links to, by their paths in it."""
    targets = re.findall(r"\]\(([^)\s#]+)", (ROOT / path).read_text(encoding="utf-8"))
    files = [(ROOT / path).parent.joinpath(target).resolve() for target in targets]
    return [f.relative_to(ROOT).as_posix() for f in files if f.is_relative_to(ROOT) and f.is_file()]


def on_files(files: Files, config) -> Files:
    """Instead of the files in docs/: the pages, and what can be reached from them."""
    paths = ["README.md", *(p.relative_to(ROOT).as_posix() for p in sorted((ROOT / "docs").rglob("*.md")))]
    for path in paths:  # which grows
        if path.endswith(".md"):
            paths += [linked for linked in dict.fromkeys(linked_from(path)) if linked not in paths]
    kept = [file for file in files if file.src_dir != config.docs_dir]  # the theme's
    for path in paths:
        to = None if PurePosixPath(path).suffix in SHOWN else f"{path}.txt"
        kept.append(File(path, str(ROOT), config.site_dir, config.use_directory_urls, dest_uri=to))
    return Files(kept)


def on_page_markdown(markdown: str, page, **_) -> None:
    """Tables of results are linked to; a search would find the same headings in every one."""
    if page.file.src_uri.startswith("runs/"):
        page.meta["search"] = {"exclude": True}

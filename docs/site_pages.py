"""Pages of the site that lie outside of docs/, and links that lead to them (a hook of MkDocs)."""

import logging
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

HOUSE = Path(__file__).parents[1]
log = logging.getLogger("mkdocs.plugins.site_pages")
ELSEWHERE = {"README.md": "index.md", "CONTRIBUTING.md": "CONTRIBUTING.md"}
"""Pages at the top of the repository, by where the site has them."""
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s#]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """The pages of docs/, with the README, the reports and the help of every command."""
    for source, place in _elsewhere().items():
        if source.endswith(".md"):
            text = relinked((HOUSE / source).read_text(encoding="utf-8"), source)
            files.append(File.generated(config, place, content=text))
        else:
            path = str(HOUSE / source)
            files.append(File.generated(config, place, abs_src_path=path))
    from bench.cli.app import make_app

    usage = make_app().generate_docs(output_format="markdown")
    usage = re.sub(
        r"^## Table of Contents\n.*?(?=^\*\*)", "", usage, flags=re.DOTALL | re.MULTILINE
    )
    # The slug of the heading `bench --install-completion` keeps all hyphens.
    usage = usage.replace("(#bench-install-completion)", "(#bench---install-completion)")
    files.append(File.generated(config, "commands.md", content=usage))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """A page of docs/, whose links lead to pages of the site."""
    if (HOUSE / "docs" / page.file.src_uri).is_file():
        return relinked(markdown, f"docs/{page.file.src_uri}")
    return markdown


def relinked(text: str, source: str) -> str:
    """The text of a page, whose links lead to where the site has their targets.

    A link to what the site does not have, such as a folder of code, becomes plain text.
    """
    places = _elsewhere()
    own = posixpath.dirname(places.get(source, source.removeprefix("docs/")))

    def replaced(match: re.Match[str]) -> str:
        image, label, target, anchor = match.groups(default="")
        if ":" in target:
            return match[0]
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), target))
        place = places.get(path)
        if place is None and path.startswith("docs/"):
            place = path.removeprefix("docs/")
        if place is None:
            return label
        return f"{image}[{label}]({posixpath.relpath(place, own or '.')}{anchor})"

    return LINK.sub(replaced, text)


def _elsewhere() -> dict[str, str]:
    """Where the site has files of the repository that lie outside of docs/."""
    reports = [*HOUSE.glob("reports/**/*.md"), *HOUSE.glob("reports/**/*.png")]
    names = [str(path.relative_to(HOUSE)) for path in sorted(reports)]
    return ELSEWHERE | {name: name for name in names}


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Warns, which fails `make docs`, where a list has become part of the paragraph above it.

    GitHub shows such a list; the site does so only if an empty line stands before it.
    """
    swallowed = re.search(r"<p>(?:(?!</p>).)*?\n- ([^\n]{0,40})", html, re.DOTALL)
    if swallowed:
        log.warning("%s: empty line missing before the list: %r", page.file.src_uri, swallowed[1])
    return html

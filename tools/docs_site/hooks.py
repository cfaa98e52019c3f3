"""Pages and links of the docs site beyond the files of `docs/`; called by mkdocs, see `mkdocs.yml`.

The pages are written for GitHub: a link is relative to its file, and may lead out of `docs/`. For the site, the pages
beside the README become pages, the examples become one page, and each section of `docs/api.md` gets a page with
signatures. Every page of the docs that a text names in backticks becomes a link.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
TOP_PAGES = {
    "README.md": "overview.md",
    "CONTRIBUTING.md": "contributing.md",
    "AGENTS.md": "agents.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
}
"""Pages of the repository's first folder, and what they are called in the site."""

SAME_PAGE = {there: here for here, there in TOP_PAGES.items()}
STYLE = (
    ".md-typeset pre > code { padding-right: 3rem; white-space: pre-wrap; overflow-wrap: anywhere; }\n"
    ".md-typeset table:not([class]) :is(th, td) { min-width: 0; padding: 0.5em 0.7em; }\n"
)
"""Long lines of code are wrapped, and tables are no wider than they must be."""
LINK_OR_CODE = re.compile(r"(?P<text>\[[^\]\n]*\])\((?P<to>[^)\s]+)\)|`(?P<code>[\w./-]+)`")
API_SECTION = re.compile(r"^## (.+)\n((?:(?!## ).*\n)*)", re.MULTILINE)
ENV_OPTIONS = "wcsim.agents.envs.env_spec.EnvOptions"
API_ROW = re.compile(r"^\| `([\w.]+)` \|", re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made; mkdocs calls it once."""
    for name, uri in TOP_PAGES.items():
        files.append(File.generated(config, uri, content=(ROOT / name).read_text(encoding="utf-8")))
    files.append(File.generated(config, "site.css", content=STYLE))
    files.append(File.generated(config, "examples.md", content=_examples()))
    for uri, text in name_pages((ROOT / "docs" / "api.md").read_text(encoding="utf-8")).items():
        files.append(File.generated(config, uri, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """The text of a page with the site's links; mkdocs calls it for each."""
    uri = page.file.src_uri
    if uri == "api.md":
        markdown = with_signatures(markdown)
    return linked(markdown, uri, SAME_PAGE.get(uri, f"docs/{uri}"))


def linked(text: str, uri: str, home: str) -> str:
    """A page's text with links to pages of the site, outside of code blocks and headings.

    Args:
        text: In Markdown, with links as GitHub follows them.
        uri: The page, from the site's root.
        home: Its file, from the repository's root.
    """

    def replaced(found: re.Match[str]) -> str:
        target, _, anchor = (found["to"] or found["code"]).partition("#")
        if found["code"]:
            there = site_uri(target)
            return f"[`{target}`]({_from(uri, there)})" if there and there.partition("#")[0] != uri else found[0]
        if not target or ":" in target:
            return found[0]
        there = site_uri(posixpath.normpath(posixpath.join(posixpath.dirname(home), target)))
        return f"{found['text']}({_from(uri, there)}{'#' + anchor if anchor else ''})" if there else found[0]

    lines, fenced = text.split("\n"), False
    for number, line in enumerate(lines):
        fenced ^= line.lstrip().startswith("```")
        if not fenced and not line.startswith(("#", "    ")):
            lines[number] = LINK_OR_CODE.sub(replaced, line)
    return "\n".join(lines)


def site_uri(path: str) -> str:
    """Where the site has a file of the repository, "" if it has it nowhere.

    >>> site_uri("docs/adr/009-rooms.md"), site_uri("README.md"), site_uri("examples/own_reward.py")
    ('adr/009-rooms.md', 'overview.md', 'examples.md#own_rewardpy')
    """
    if path in TOP_PAGES:
        return TOP_PAGES[path]
    folder, _, rest = path.partition("/")
    if not (ROOT / path).is_file():
        return ""
    if folder == "examples":
        return f"examples.md#{rest.replace('.', '')}"
    return rest if folder == "docs" else ""


def name_pages(api_page: str) -> dict[str, str]:
    """A page for each section of `docs/api.md`, by its place in the site, in the directives of mkdocstrings."""
    pages = {}
    for title, table in API_SECTION.findall(api_page):
        plain = title.replace("`", "")
        place = f"names/{re.sub(r'[^a-z0-9_]+', '-', plain.partition(':')[0].lower())}.md"
        names = dict.fromkeys(whole for name in API_ROW.findall(table) if (whole := _whole(name, title)))
        pages[place] = "\n\n".join([f"# {plain}", *(f"::: {name}" for name in names)]) + "\n"
    return pages


def with_signatures(api_page: str) -> str:
    """`docs/api.md` with each name leading to its signature, as mkdocstrings finds it."""

    def row(found: re.Match[str], title: str) -> str:
        whole = _whole(found[1], title)
        return f"| [`{found[1]}`][{whole}] |" if whole else found[0]

    def section(found: re.Match[str]) -> str:
        return API_ROW.sub(lambda name: row(name, found[1]), found[0])

    return API_SECTION.sub(section, api_page)


def _whole(name: str, title: str) -> str:
    """A name of `docs/api.md` with its module, by the title that it stands below; "" for a method of a class."""
    if title == "Options of an environment":
        return ENV_OPTIONS  # its rows are fields of one class
    if name.startswith("."):
        return ""
    return name if "." in name else f"{title.replace('`', '').partition(':')[0]}.{name}"


def _examples() -> str:
    said = "# Examples\n\nThe files of `examples/`. Each of them is tested.\n"
    return said + "".join(_shown(path) for path in _example_files())


def _shown(path: Path) -> str:
    language = "python" if path.suffix == ".py" else path.suffix[1:]
    return f"\n## {path.name}\n\n```{language}\n{path.read_text(encoding='utf-8')}```\n"


def _example_files() -> list[Path]:
    return sorted(path for path in (ROOT / "examples").iterdir() if path.suffix in (".py", ".toml"))


def _from(uri: str, there: str) -> str:
    """A link from one page of the site to another."""
    return posixpath.relpath(there, posixpath.dirname(uri) or ".")

"""The docs site builds strictly, asks for nothing from outside, and holds what users may rely on."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import Abort

from tests.support.tracked import ROOT
from tools.docs_site.hooks import linked, name_pages, site_uri, with_signatures

CONFIG = ROOT / "tools" / "docs_site" / "mkdocs.yml"
FROM_OUTSIDE = re.compile(r"""<(?:script|img|iframe|source|link)\b[^>]*\b(?:src|href)=["']?(?:https?:)?//[^>]*>""")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole site, built as `make docs` builds it."""
    place = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict"]
    command += ["--config-file", str(CONFIG), "--site-dir", str(place)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return place


@pytest.mark.timeout(1200)  # a few seconds of processor time, which a busy machine gives slowly
def test_the_site_builds_without_a_warning_and_asks_for_nothing_from_outside(site: Path) -> None:
    pages = {path: path.read_text() for path in site.rglob("*.html")}
    assert len(pages) > 50
    assert {str(path): found for path, text in pages.items() if (found := FROM_OUTSIDE.findall(text))} == {}
    styles = [path.read_text() for path in site.rglob("*.css")]
    assert not [text for text in styles if re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", text)]
    assert not [path for path, text in pages.items() if 'class="mermaid"' in text]  # its script comes from elsewhere
    assert 'href="site.css"' in pages[site / "drive.html"] and "pre-wrap" in (site / "site.css").read_text("utf-8")
    assert (site / "search" / "search_index.json").stat().st_size > 100_000


@pytest.mark.timeout(1200)
def test_every_name_of_the_api_page_leads_to_its_signature(site: Path) -> None:
    rows = re.findall(r"^\| `(?!\.)([\w.]+)` \|", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE)
    page = (site / "api.html").read_text()
    targets = re.findall(r'href="(names/[^"#]+)#([^"]+)"', page)
    assert len(targets) >= len(rows) > 100
    for name, anchor in set(targets):
        assert f'id="{anchor}"' in (site / name).read_text()
    actors = (site / "names" / "wcsim-types.html").read_text()
    assert "sideways offset that the bridge added to SUMO's pose" in actors  # a field's comment is its text


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "text, stray",
    [("[a](gone.md)", ""), ("[a](#gone)", ""), ("[a](other.md#gone)", ""), ("good", "# a page in no part\n")],
    ids=["page", "anchor", "anchor of another page", "page in no part"],
)
def test_a_fault_ends_the_build(text: str, stray: str, tmp_path: Path) -> None:
    """The site's own configuration, on small pages without plugins."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(f"# Page\n\n{text}\n")
    (tmp_path / "docs" / "other.md").write_text("# Other\n")
    if stray:
        (tmp_path / "docs" / "stray.md").write_text(stray)
    settings = {"docs_dir": str(tmp_path / "docs"), "site_dir": str(tmp_path / "site"), "hooks": [], "plugins": []}
    config = load_config(str(CONFIG), nav=["index.md", "other.md"], theme="mkdocs", **settings)
    with pytest.raises(Abort):
        build(config)


def test_links_of_github_become_those_of_the_site() -> None:
    assert linked("[a](../examples/own_reward.py)", "authoring.md", "docs/authoring.md").endswith(
        "(examples.md#own_rewardpy)"
    )
    assert linked("[a](docs/faces.md#gymnasium)", "overview.md", "README.md") == "[a](faces.md#gymnasium)"
    assert linked("see `docs/chair.md`", "adr/009-rooms.md", "docs/adr/009-rooms.md") == (
        "see [`docs/chair.md`](../chair.md)"
    )
    for kept in (
        "# `docs/chair.md`",
        "    `docs/chair.md`",
        "```\n`docs/chair.md`\n```",
        "[a](https://b.c)",
        "[a](#b)",
    ):
        assert linked(kept, "user.md", "docs/user.md") == kept
    assert linked("`docs/user.md`", "user.md", "docs/user.md") == "`docs/user.md`"  # not to itself


def test_files_that_the_site_has_not_are_no_links() -> None:
    assert site_uri("README.md") == "overview.md"
    assert site_uri("docs/adr/009-rooms.md") == "adr/009-rooms.md"
    assert [site_uri(path) for path in ("wcsim/errors.py", "docs/gone.md", "Makefile")] == ["", "", ""]


def test_names_are_found_by_the_title_above_them() -> None:
    first = "## `wcsim.errors`: what\n\n| name | what |\n|---|---|\n| `TownError` | a |\n\n"
    api = f"{first}## A network\n\n| `wcsim.a.B` | b |\n| `.c` | c |\n"
    assert name_pages(api) == {
        "names/wcsim-errors.md": "# wcsim.errors: what\n\n::: wcsim.errors.TownError\n",
        "names/a-network.md": "# A network\n\n::: wcsim.a.B\n",
    }
    assert "| [`TownError`][wcsim.errors.TownError] | a |" in with_signatures(api)
    assert "| [`wcsim.a.B`][wcsim.a.B] | b |\n| `.c` | c |" in with_signatures(api)

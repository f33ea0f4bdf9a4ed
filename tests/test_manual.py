"""The web site of the manual: formulas, requests, links, and search."""

import json
import pathlib
import re
from urllib.parse import unquote, urldefrag, urljoin

import pytest


pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

ROOT = pathlib.Path(__file__).parents[1]
LATEX = r"\$[^$]+\$|\\[A-Za-z(\[]|[_^]\{"
# What a browser loads by itself; links are loaded when a reader follows them.
LOADED = {
    "link[rel~=stylesheet], link[rel~=icon], link[rel~=preload]": "href",
    "link[rel~=modulepreload], link[rel~=preconnect]": "href",
    "script, img, iframe, embed, source, video, audio": "src",
    "img[srcset], source[srcset]": "srcset",
    "object": "data",
    "svg image, svg use": "href",
}
ELSEWHERE = r"(?i)^\s*(https?:)?//"
IN_STYLES = r"(?i)url\(\s*['\"]?\s*(?:https?:)?//|@import\s+['\"]\s*(?:https?:)?//"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site with empty figures instead of those that its code draws."""
    mkdocs = pytest.importorskip("mkdocs.config")
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings")
    pytest.importorskip("mkdocs_jupyter")
    pytest.importorskip("latex2mathml")
    from mkdocs.commands.build import build

    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setenv("FIGURES", "empty")
        config = mkdocs.load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder))
        config.plugins["mkdocs-jupyter"].config["cache"] = False
        config.plugins.on_startup(command="build", dirty=False)
        build(config)
    return folder


@pytest.fixture(scope="module")
def pages(site):
    """Return the parsed pages by their path in the site."""
    bs4 = pytest.importorskip("bs4")
    found = {
        path.relative_to(site).as_posix(): bs4.BeautifulSoup(
            path.read_text(), "html.parser"
        )
        for path in site.rglob("*.html")
    }
    assert len(found) > 50
    return found


def latex_in(page) -> list[str]:
    """Return what looks like LaTeX in the text that a page shows, outside of code."""
    hidden = {"pre", "code", "script", "style", "svg", "head"}
    return [
        text.strip()
        for text in page.find_all(string=re.compile(LATEX))
        if not any(
            parent.name in hidden or "clipboard-copy-txt" in parent.get("class", ())
            for parent in text.parents
        )
    ]


def requests_of(page) -> list[str]:
    """Return what a browser that shows this page requests from other servers."""
    loaded = [
        element[attribute]
        for selector, attribute in LOADED.items()
        for element in page.select(selector)
        if re.match(ELSEWHERE, element.get(attribute, ""))
    ]
    styles = [tag.get_text() for tag in page("style")]
    styles += [tag["style"] for tag in page.select("[style]")]
    loaded += [text[:200] for text in styles if re.search(IN_STYLES, text)]
    scripts = [tag.get_text() for tag in page("script")]
    return loaded + [
        found
        for text in scripts
        for found in re.findall(r"(?:import|fetch)\(\s*[\"']https?:[^)]*", text)
    ]


def broken_links(pages, site) -> list[str]:
    """Return links inside the site to missing files and missing anchors."""
    anchors = {
        path: {tag.get("id") or tag.get("name") for tag in page.select("[id], a[name]")}
        for path, page in pages.items()
    }
    broken = []
    for path, page in pages.items():
        for link in page.select("a[href], area[href], link[href], img[src], script[src]"):
            href = link.get("href") or link["src"]
            if re.match(r"[a-z]+:|//", href):
                continue
            target, anchor = urldefrag(urljoin(f"/{path}", href))
            target = unquote(target).lstrip("/")
            if not target or target.endswith("/"):
                target += "index.html"
            if not (site / target).is_file() or (
                anchor and unquote(anchor) not in anchors[target]
            ):
                broken.append(f"{path}: {href}")
    return broken


def test_no_page_shows_latex(pages):
    found = {path: latex for path, page in pages.items() if (latex := latex_in(page))}
    assert not found


def test_no_page_loads_a_file_of_another_server(pages, site):
    found = {
        path: loaded for path, page in pages.items() if (loaded := requests_of(page))
    }
    assert not found
    styles = list(site.rglob("*.css"))
    assert styles
    assert not [path for path in styles if re.search(IN_STYLES, path.read_text())]


def test_all_links_within_the_site_lead_to_a_page_and_to_an_anchor(pages, site):
    assert not broken_links(pages, site)


def test_a_search_finds_guides_before_the_api(site):
    index = json.loads((site / "search" / "search_index.json").read_text())
    boosts = {
        folder: {
            document.get("boost", 1)
            for document in index["docs"]
            if document["location"].startswith(f"{folder}/")
        }
        for folder in ("manual", "api")
    }
    assert min(boosts["manual"]) > 10 * max(boosts["api"])

"""Hook of mkdocs: formulas, notebooks, and the order of search results.

Formulas are MathML, which browsers show without a script. Pages of notebooks
need no file of another server. A search finds guides before API pages.
"""

import re
from html import unescape

from latex2mathml.converter import convert
from mkdocs.structure.pages import Page


CODE = (
    r"<(pre|code|script|style|svg)\b.*?</\2>"
    r"|<div class=\"clipboard-copy-txt.*?</div>"
)
ARITHMATEX = (  # formulas of Markdown pages, inline and displayed
    r"<(span|div) class=\"arithmatex\">\\(?:\((.+?)\\\)|\[(.+?)\\\])</\1>"
)
DOLLARS = (  # those of notebooks; $ in code and in attributes of tags is none
    rf"({CODE}|<[^>]*>)|\$\$(.+?)\$\$|\$(?!\s)([^$]+?)(?<!\s)\$"
)
# Scripts of nbconvert for formulas and diagrams
SCRIPTS = (
    r"<!-- Load mathjax -->.*?<!-- End of mathjax configuration -->"
    r"|<script type=\"module\">(?:(?!</script>).)*mermaid.*?</script>"
)
# matplotlib's animations load the icons of their buttons from a server.
ICONS = {
    "minus": "−",
    "fast-backward": "❙◀",
    "step-backward": "◂",
    "play fa-flip-horizontal": "◀",
    "pause": "❙❙",
    "play": "▶",
    "step-forward": "▸",
    "fast-forward": "▶❙",
    "plus": "+",
}
# A match in a title counts 1000 times more than one in a text.
BOOSTS = {"api": 0.05, "manual": 4, "gallery": 4}


def on_page_content(html: str, page: Page, **_: object) -> str:
    """Replace formulas, and complete the pages of notebooks."""
    page.meta["search"] = {"boost": BOOSTS.get(page.url.split("/")[0], 1)}
    if not page.file.src_uri.endswith(".ipynb"):
        return re.sub(
            ARITHMATEX, lambda m: mathml(m[2], m[3]), html, flags=re.DOTALL
        )
    html = re.sub(SCRIPTS, "", html, flags=re.DOTALL)
    html = re.sub(r"<link[^>]+font-awesome[^>]+>", "", html)
    # mkdocs translates links to files in Markdown pages only.
    html = re.sub(r'(href=")([\w/-]+)\.(?:md|ipynb)\b', r"\1../\2/", html)
    for icon, text in ICONS.items():
        html = html.replace(f'<i class="fa fa-{icon}"></i>', text)
    return re.sub(
        DOLLARS, lambda m: m[1] or mathml(m[4], m[3]), html, flags=re.DOTALL
    )


def mathml(inline: str | None, displayed: str | None) -> str:
    """Return a formula as MathML."""
    text = convert(
        unescape(inline or displayed or ""),
        display="inline" if inline else "block",
    )
    text = text.replace(
        "<mo>&#x0002F;", '<mo lspace="0" rspace="0">&#x0002F;'
    )
    name, space = r"<mi>[a-z]{2,}</mi>", '<mspace width="0.167em" />'
    text = re.sub(rf"(?<=</mi>)(?={name})", space, text)
    return re.sub(rf"({name})(?!<mo stretchy)", rf"\1{space}", text)

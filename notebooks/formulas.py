"""Hook of mkdocs: formulas, requests, and the order of search results.

Formulas are MathML, which browsers show without a script. Pages of notebooks
need no file of another server. A search finds guides before API pages.
"""

import re
from html import unescape

from latex2mathml.converter import convert
from mkdocs.structure.pages import Page


CODE = r"<(pre|code|script|style|svg)\b.*?</\2>|<div class=\"clipboard-copy-txt.*?</div>"
ARITHMATEX = (  # formulas of Markdown pages, inline and displayed
    r"<(span|div) class=\"arithmatex\">\\(?:\((.+?)\\\)|\[(.+?)\\\])</\1>"
)
DOLLARS = (  # those of notebooks; $ in code and in attributes of tags is none
    rf"({CODE}|<[^>]*>)|\$\$(.+?)\$\$|\$(?!\s)([^$]+?)(?<!\s)\$"
)
# Scripts of nbconvert for formulas and diagrams
SCRIPTS = (
    r"<!-- Load mathjax -->.*?<!-- End of mathjax configuration -->"
    r"|<script type=\"module\">\s*document(?:(?!</script>).)*mermaid.*?</script>"
)
# matplotlib's animations load the icons of their buttons from a server.
ICONS = {
    "minus": "−",
    "fast-backward": "⏮",
    "step-backward": "◂❙",
    "play fa-flip-horizontal": "◀",
    "pause": "❙❙",
    "play": "▶",
    "step-forward": "❙▸",
    "fast-forward": "⏭",
    "plus": "+",
}
BOOSTS = {"api": 0.001, "manual": 2, "gallery": 2}


def on_page_content(html: str, page: Page, **_: object) -> str:
    """Replace formulas, and remove what loads files of other servers."""
    page.meta["search"] = {"boost": BOOSTS.get(page.url.split("/")[0], 1)}
    if not page.file.src_uri.endswith(".ipynb"):
        return re.sub(
            ARITHMATEX, lambda m: mathml(m[2], m[3]), html, flags=re.DOTALL
        )
    html = re.sub(SCRIPTS, "", html, flags=re.DOTALL)
    html = re.sub(r"<link[^>]+font-awesome[^>]+>", "", html)
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
    name, space = r"<mi>[a-z]{2,}</mi>", '<mspace width="0.167em" />'
    text = re.sub(rf"(?<=</mi>)(?={name})", space, text)
    return re.sub(rf"({name})(?!<mo stretchy)", rf"\1{space}", text)

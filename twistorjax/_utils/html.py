"""HTML pages that stand alone."""

from html import escape


_PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 16px/1.5 sans-serif; max-width: 60rem; }}
body {{ margin: 1rem auto; padding: 0 1rem; }}
pre {{ overflow-x: auto; font-size: 13px; }}
svg {{ max-width: 100%; height: auto; background: white; border-radius: 6px; }}
</style>
{body}
</html>
"""


def page(title: str, body: str) -> str:
    """Return a page with a title, which is text, and a body, which is HTML."""
    return _PAGE.format(title=escape(title), body=body)

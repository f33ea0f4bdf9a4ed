"""How the manual reads docstrings: an `Example:` is code, and what it prints."""

import re

import griffe


class Examples(griffe.Extension):
    """Calls the section what griffe's parser knows."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        """Of every module, class, function and attribute."""
        if obj.docstring:
            text = obj.docstring.value
            obj.docstring.value = re.sub(r"(?m)^( *)Example:$", r"\1Examples:", text)

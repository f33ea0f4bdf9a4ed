"""Extension of mkdocstrings: `Example:` sections are shown as code."""

import re

import griffe


class Examples(griffe.Extension):
    """Rename sections `Example:` to `Examples:`, which griffe parses."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        """Rename the section in the docstring of one object.

        Args:
            obj: Module, class, function, or attribute.
        """
        if obj.docstring:
            text = obj.docstring.value
            obj.docstring.value = re.sub(
                r"(?m)^( *)Example:$", r"\1Examples:", text
            )

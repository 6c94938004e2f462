# SPDX-License-Identifier: Apache-2.0
"""Pages from templates."""

from __future__ import annotations

import functools

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template


@functools.cache
def page_template(package: str, name: str) -> Template:
    """A page of `templates` of a package or of this one: a lack is an error, what shows escaped."""
    return Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("robir.export")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    ).get_template(name)

"""The guide: Markdown pages beside this file, rendered to HTML with MathML equations. No script, no inline style.

To add a page: a `.md` file here and its row in PAGES.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

from app.errors import NotFoundError

HERE = Path(__file__).parent

PAGES: dict[str, str] = {
    "start": "Start here",
    "pages": "The pages and their keys",
    "monitor": "Live: watching and driving a robot",
    "live": "Live: connecting a robot",
    "ros": "ROS 2 into the dashboard, without ROS",
    "methods": "Methods: where each path comes from",
    "published": "The published system, as we read it",
    "imu": "Gyro: noise and bias",
    "calibration": "IMU calibration",
    "odometry": "Calibrating wheels, gyro and mounts",
    "firmware": "Firmware",
    "events": "Events: slips, blows, dead encoders",
    "diagnoses": "Reading a diagnosis",
    "gap": "The gap: where, which, how far",
    "numbers": "What each number means",
    "figures": "Figures, honestly",
    "run-format": "The run format",
    "effects": "The effects",
    "own-simulator": "Your own simulator",
    "api": "REST API",
    "cli": "Command line",
    "operate": "Running it for others",
    "code": "Two walks through the code",
    "extend": "How to add things",
}


@dataclass(frozen=True)
class Section:
    """A heading of a page: its anchor, its text, its level (2 or 3)."""

    anchor: str
    text: str
    level: int


@dataclass(frozen=True)
class GuidePage:
    """One rendered page: HTML body, title, and the sections for the table of contents."""

    name: str
    title: str
    html: str
    sections: tuple[Section, ...]


def slug(text: str) -> str:
    """The anchor of a heading: lower case words joined by hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def source(name: str) -> str:
    """The Markdown text of a page."""
    if name not in PAGES:
        raise NotFoundError(f"the guide has no page {name!r}; it has {', '.join(PAGES)}", page=name)
    return (HERE / f"{name}.md").read_text(encoding="utf-8")


def _mathml(text: str, options: dict[str, Any]) -> str:
    from latex2mathml.converter import convert

    return str(convert(text, display="block" if options["display_mode"] else "inline"))


def _highlight(code: str, language: str, _attrs: str) -> str:
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import get_lexer_by_name
    from pygments.util import ClassNotFound

    try:
        lexer = get_lexer_by_name(language.split()[0] if language else "text")
    except ClassNotFound:
        return ""
    return str(highlight(code, lexer, HtmlFormatter(nowrap=True)))


def _parser() -> MarkdownIt:
    from mdit_py_plugins.dollarmath import dollarmath_plugin

    parser = MarkdownIt("commonmark", {"highlight": _highlight, "html": False, "typographer": False})
    return parser.enable("table").use(dollarmath_plugin, renderer=_mathml, allow_space=False)


@cache
def render(name: str) -> GuidePage:
    """A page as HTML. Headings get anchors, links between pages lead to `/guide/<name>`."""
    parser = _parser()
    tokens = parser.parse(source(name))
    sections: list[Section] = []
    for opening, inline in itertools.pairwise(tokens):
        if opening.type == "heading_open" and inline.content:
            anchor = slug(inline.content)
            opening.attrSet("id", anchor)
            if opening.tag in ("h2", "h3"):
                sections.append(Section(anchor, inline.content.replace("`", ""), int(opening.tag[1])))
        for child in inline.children or ():
            if child.type == "link_open":
                child.attrSet("href", re.sub(r"^([a-z-]+)\.md", r"/guide/\1", str(child.attrGet("href"))))
        for token in (opening, inline):
            # Alignment comes as an inline style, which the content policy refuses.
            style = str(token.attrs.pop("style", ""))
            if "right" in style:
                token.attrSet("class", "number")
    html = parser.renderer.render(tokens, parser.options, {})
    return GuidePage(name, PAGES[name], str(html), tuple(sections))

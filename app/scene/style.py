"""How the scene looks: the pages' colours and dashes per method (tokens.css, static/lib/methods.js), line widths."""

from __future__ import annotations

from dataclasses import dataclass

Rgb = tuple[int, int, int]
THEMES = ("light", "dark")


@dataclass(frozen=True)
class Stroke:
    """One method's line: colour per theme, dash pattern in line units (pen down, pen up, ...), width in pixels."""

    light: Rgb
    dark: Rgb
    dash: tuple[float, ...] = ()
    width: float = 2.5

    def colour(self, theme: str) -> Rgb:
        """The colour in a theme."""
        return self.dark if theme == "dark" else self.light

    def body(self, theme: str) -> Rgb:
        """The colour of a lit body, which the lights make brighter than a line."""
        r, g, b = self.colour(theme)
        return int(0.72 * r), int(0.72 * g), int(0.72 * b)


@dataclass(frozen=True)
class Theme:
    """Ground and ink of one theme."""

    ink: Rgb
    cell: Rgb
    section: Rgb
    wheel: Rgb


def _same(rgb: Rgb, dash: tuple[float, ...] = (), width: float = 2.5) -> Stroke:
    return Stroke(rgb, rgb, dash, width)


STROKES: dict[str, Stroke] = {
    "truth": Stroke((20, 24, 28), (233, 236, 239), width=3.0),
    "encoders": _same((230, 159, 0), (3.5, 1.5)),
    "beacon": _same((86, 180, 233), (1, 1.5)),
    "encoders+gyro": _same((213, 94, 0), (4.5, 1.5, 1, 1.5)),
    "published": _same((204, 121, 167), (2.5, 1, 0.5, 1, 0.5, 1)),
    "fused": Stroke((0, 114, 178), (47, 147, 214), width=3.5),
    "smoothed": _same((0, 158, 115), (6, 1.5), width=3.0),
}
OTHER = _same((128, 134, 140), (2, 1))
FIXES = Stroke((120, 150, 172), (112, 140, 160))
BEACON = (86, 180, 233)

# Events: colour of the family as on the pages, and how round the head of its pin is.
EVENTS: dict[str, tuple[Rgb, int]] = {
    **dict.fromkeys(("slip", "collision"), ((196, 48, 43), 1)),
    **dict.fromkeys(("bounce", "beacon_loss", "beacon_lying"), ((190, 130, 20), 3)),
    **dict.fromkeys(("pushed", "kidnap", "replacement"), ((120, 105, 220), 3)),
}
EVENT_OTHER: tuple[Rgb, int] = ((120, 130, 138), 1)

THEME: dict[str, Theme] = {
    "light": Theme(ink=(20, 24, 28), cell=(226, 229, 232), section=(196, 202, 208), wheel=(45, 50, 56)),
    "dark": Theme(ink=(233, 236, 239), cell=(54, 60, 66), section=(88, 97, 106), wheel=(150, 158, 166)),
}

GAP = ((140, 150, 158), (224, 160, 96), (232, 148, 66), (226, 124, 40), (206, 92, 22), (160, 60, 10), (104, 34, 4))
"""Colours of a path by the gap over its floor: the steps of `app.figures.gap.LEVELS`."""
GAPS: dict[str, tuple[Rgb, ...]] = {
    "light": GAP,
    "dark": (
        (90, 100, 109),
        (148, 103, 47),
        (176, 122, 49),
        (208, 140, 51),
        (238, 159, 63),
        (255, 191, 119),
        (255, 224, 189),
    ),
}
"""The same by theme, as `--path-0` to `--path-6` of gap.css: what is far off must stand out from the ground."""

SPEED = (
    (150, 158, 165),
    (128, 147, 167),
    (107, 136, 169),
    (86, 125, 170),
    (64, 114, 172),
    (32, 103, 174),
    (0, 92, 178),
)
"""Colours of a path by its speed, from rest to the fastest so far."""

TRAILS: dict[str, tuple[Rgb, ...]] = {"speed": SPEED, "gap": GAP}

# Whose robot the camera follows, and which one stands solid: the best claim first.
PRECEDENCE = ("fused", "smoothed", "published", "encoders+gyro", "encoders", "beacon", "truth")


def stroke(method: str) -> Stroke:
    """The method's line; a quiet grey for methods without a colour of their own."""
    return STROKES.get(method, OTHER)


def primary(methods: tuple[str, ...] | list[str]) -> str | None:
    """The method whose robot leads."""
    ranked = sorted(methods, key=lambda m: PRECEDENCE.index(m) if m in PRECEDENCE else len(PRECEDENCE))
    return ranked[0] if ranked else None


def slug(method: str) -> str:
    """The method as part of a node's name."""
    return method.replace("/", "-").replace("+", "-")

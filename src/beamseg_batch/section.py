"""Cross-sections of members, as rectangles about their centre of area."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["SHAPES", "Section", "Shape"]

Shape = Literal["round", "square", "i", "l", "c"]
"""Cross-sections of a member: round bar or tube, square tube, I or H, angle, channel."""

SHAPES: tuple[Shape, ...] = ("round", "square", "i", "l", "c")


@dataclass(frozen=True)
class Section:
    """Cross-section of a member, about its centre of area.

    Attributes
    ----------
    shape : Shape
    width, height : float, metres
        Extent along the section's own u and v; both the diameter if `shape` is round.
    web, flange : float, metres
        Thickness of the parts along v, and of those along u. An I has two flanges and a
        web between their middles, a channel one between their left ends, an angle one leg
        along u at the bottom and one along v at the left. Zero for a round section.
    """

    shape: Shape
    width: float
    height: float
    web: float = 0.0
    flange: float = 0.0

    @property
    def radius(self) -> float:
        """Half the larger extent, metres: the radius, if the section is round."""
        return max(self.width, self.height) / 2.0

    def grown(self, by: float) -> Section:
        """Return a section whose outside lies further out by `by` metres all around."""
        web, flange = ((t + 2.0 * by if t else 0.0) for t in (self.web, self.flange))
        return Section(self.shape, self.width + 2.0 * by, self.height + 2.0 * by, web, flange)

    def plates(self) -> list[tuple[float, float, float, float]]:
        """Return the rectangles that a section which is not round is made of.

        Returns
        -------
        list of (centre u, centre v, width, height), metres
            About the section's centre of area. They do not overlap. Empty if the section
            is round. The tube is closed: its outside alone can be seen.
        """
        width, height, web, flange = self.width, self.height, self.web, self.flange
        if self.shape == "round":
            return []
        if self.shape == "square":
            return [(0.0, 0.0, width, height)]
        inner = height - 2.0 * flange
        left = (web - width) / 2.0
        flanges = [
            (0.0, (flange - height) / 2.0, width, flange),
            (0.0, (height - flange) / 2.0, width, flange),
        ]
        plates = {
            "i": [*flanges, (0.0, 0.0, web, inner)],
            "c": [*flanges, (left, 0.0, web, inner)],
            "l": [flanges[0], (left, flange / 2.0, web, height - flange)],
        }[self.shape]
        area = sum(w * h for _, _, w, h in plates)
        u = sum(u * w * h for u, _, w, h in plates) / area
        v = sum(v * w * h for _, v, w, h in plates) / area
        return [(pu - u, pv - v, w, h) for pu, pv, w, h in plates]

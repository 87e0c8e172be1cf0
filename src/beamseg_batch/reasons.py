"""Why something is not a beam: every reason, declared once.

The names are the keys of `summary.json` and of `candidates.parquet`; the texts are those
of the terminal, the report, `beamseg explain` and the documentation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

__all__ = ["KINDS", "LEFTOVER", "REASONS", "Kind", "Reason", "documentation", "in_words"]

Kind: TypeAlias = Literal["lines", "leftover_lines", "candidates"]
"""What is refused: a line of a scan, one of what no beam explains, a candidate for a beam."""

KINDS: tuple[Kind, ...] = ("lines", "leftover_lines", "candidates")

LEFTOVER = "leftover_"
"""What the names of reasons begin with for lines in what no beam explains."""


@dataclass(frozen=True)
class Reason:
    """One reason.

    Attributes
    ----------
    name : str
        Stable, and the same nowhere else.
    kind : {'lines', 'leftover_lines', 'candidates'}
    meaning : str
        A phrase that follows a count, whatever it is: "12 seen in too few scans".
    detail : str
        A phrase about one thing, with the fields ``value``, ``limit`` and ``other``: what was
        found, what was needed, and which candidate was in the way.
    setting : str
        Configuration values that decide, joined by commas; empty if there is none.
    """

    name: str
    kind: Kind
    meaning: str
    detail: str
    setting: str = ""

    def tell(self, value: float, limit: float, other: str = "another one") -> str:
        """Say what was found and what was needed.

        Parameters
        ----------
        value, limit : float
            In the unit of the reason.
        other : str
            What to call the candidate that was in the way.

        Returns
        -------
        str
        """
        return self.detail.format(value=value, limit=limit, other=other)


_LINES = (
    Reason(
        "too_few_points",
        "lines",
        "with too few points for the length",
        "{value:.0f} points, at least {limit:.0f} needed for its length",
        "detection.screening.min_points_factor, detection.hough.minvotes",
    ),
    Reason(
        "wrong_radius",
        "lines",
        "of another thickness",
        "its furthest point is {value:.3f} m off the expected radius, less than {limit:.3f} m "
        "needed",
        "filtering.radii, detection.screening.radius_tolerance_factor",
    ),
    Reason(
        "gap",
        "lines",
        "with a gap",
        "a gap of {value:.3f} m between neighbouring points, at most {limit:.3f} m allowed",
        "detection.screening.max_gap_factor, detection.screening.gap",
    ),
    Reason(
        "low_pca_coeff",
        "lines",
        "not elongated enough",
        "{value:.3%} of its points' variance lies along it, at least {limit:.3%} needed",
        "detection.screening.min_pca_coeff",
    ),
    Reason(
        "below_floor",
        "lines",
        "with an end below the floor trim",
        "its lower end is at z = {value:.3f} m, above {limit:.3f} m needed",
        "filtering.floor_trim_height, filtering.floor_trim",
    ),
)

_CANDIDATES = (
    Reason(
        "too_few_sightings",
        "candidates",
        "found in too few scans",
        "found {value:.0f} times in single scans, at least {limit:.0f} times needed",
        "structure.min_scans",
    ),
    Reason(
        "no_evidence",
        "candidates",
        "denied by the rays",
        "no part of it is likely: the best stretch of its axis has a log-likelihood ratio of "
        "{value:.0f}, more than {limit:.0f} needed",
    ),
    Reason(
        "low_score",
        "candidates",
        "with too little evidence",
        "too little evidence: a log-likelihood ratio of {value:.0f}, at least {limit:.0f} needed",
        "refinement.drop",
    ),
    Reason(
        "low_share",
        "candidates",
        "seen through too often",
        "its score is {value:.0%} of the best that its hits could give, at least {limit:.0%} "
        "needed: the others saw through it or fit badly",
        "refinement.drop",
    ),
    Reason(
        "outdone",
        "candidates",
        "explained better by another",
        "{other} explains its rays better: a log-likelihood ratio of {limit:.0f}, while "
        "{value:.0f} is left for this one",
        "refinement.competition",
    ),
    Reason(
        "evidence_too_short",
        "candidates",
        "too short to be told",
        "rays show {value:.2f} m of it, at least {limit:.2f} m needed",
        "refinement.drop",
    ),
    Reason(
        "not_free",
        "candidates",
        "part of a surface",
        "{value:.0%} of the rays that pass closely beside it found something at its depth, at "
        "most {limit:.0%} allowed: it is part of a surface, such as a wall or a board",
        "refinement.drop",
    ),
    Reason(
        "duplicate",
        "candidates",
        "the same as another",
        "the same beam as {other}: {value:.3f} m apart, less than {limit:.3f} m",
        "refinement.merge",
    ),
    Reason(
        "merged",
        "candidates",
        "going on where another ends",
        "one beam with {other}, which it continues: {value:.3f} m off its axis, less than "
        "{limit:.3f} m",
        "refinement.merge",
    ),
    Reason(
        "bent",
        "candidates",
        "part of a bent one",
        "one bent beam with {other}: a bow of {value:.3f} m, at most {limit:.3f} m",
        "refinement.bow",
    ),
    Reason(
        "shapeless",
        "candidates",
        "of no known shape, and not free on either side",
        "fits neither a round beam nor another section, and goes on beside itself",
        "structure.shapes.enabled",
    ),
    Reason(
        "section_part",
        "candidates",
        "part of another's cross-section",
        "lies in the cross-section of {other}, or goes on with it",
        "structure.shapes.enabled",
    ),
    Reason(
        "collision",
        "candidates",
        "inside another",
        "runs inside {other}: {value:.3f} m between the axes, at least {limit:.3f} m needed, "
        "since two solids cannot share their place",
        "refinement.drop",
    ),
    Reason(
        "superseded",
        "candidates",
        "replaced by others",
        "other candidates took its place",
    ),
    Reason(
        "too_few_scans",
        "candidates",
        "seen in too few scans",
        "seen in {value:.0f} scans, at least {limit:.0f} needed",
        "structure.min_scans",
    ),
    Reason(
        "too_short",
        "candidates",
        "too short",
        "{value:.2f} m long, at least {limit:.2f} m needed",
        "structure.min_length",
    ),
)

REASONS: Mapping[str, Reason] = {
    reason.name: reason
    for reason in (
        *_LINES,
        *(
            replace(line, name=f"{LEFTOVER}{line.name}", kind="leftover_lines")
            for line in _LINES
            if line.name != "below_floor"
        ),
        *_CANDIDATES,
    )
}
"""Every reason by its name: of lines in the order in which they are asked, then of candidates."""


def in_words(counts: Mapping[str, int], kind: Kind, most: int = 3) -> str:
    """Say how many were refused for which reasons.

    Parameters
    ----------
    counts : mapping of str to int
        By the name of the reason; those of other kinds do not count.
    kind : {'lines', 'leftover_lines', 'candidates'}
    most : int
        Reasons that are named; the rest is summed up.

    Returns
    -------
    str
        How many in all, then the most frequent reasons; empty if none was refused.
    """
    found = [
        (count, reason.meaning)
        for name, reason in REASONS.items()
        if reason.kind == kind and (count := counts.get(name, 0))
    ]
    found.sort(key=lambda entry: -entry[0])
    told = [f"{count} {meaning}" for count, meaning in found[:most]]
    rest = sum(count for count, _ in found[most:])
    told += [f"{rest} for other reasons"] * bool(rest)
    total = sum(count for count, _ in found)
    what = kind.replace("_", " ").removesuffix("s" if total == 1 else "")
    return f"{total} {what}: {', '.join(told)}" if told else ""


def documentation() -> str:
    """Describe the reasons for people: Markdown, a table with a row per reason."""
    rows = [
        f"| `{r.name}` | {r.kind.replace('_', ' ')} | {r.meaning} | "
        f"{', '.join(f'`{key}`' for key in filter(None, r.setting.split(', '))) or '–'} |"
        for r in REASONS.values()
    ]
    return "\n".join(["| name | counts | which | decided by |", "|---|---|---|---|", *rows]) + "\n"

"""Which radii the beams of a flight have, as their own rays measure them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beamseg_batch.structure.hypothesis import Beam

__all__ = ["radius_classes", "reclassed"]

_APART = 1.12  # ratio of radii that are two classes
_TRUSTED = 0.04  # share of its radius to which a beam must know it, to speak for a class
_SURE = 2.5  # deviations by which a radius is wrong
_GROWS, _SHRINKS = 1.04, 0.5  # times the present radius: what is thicker grows; none is thinner
_FLOOR_M = 2e-4  # what the deviation of a radius does not tell


def radius_classes(beams: Sequence[Beam], *, rough: bool = False) -> tuple[float, ...]:
    """Radii that beams have in common.

    Parameters
    ----------
    beams : sequence of Beam
    rough : bool, optional
        Whether beams speak, too, that know no more than that their present radius is wrong: what
        is far too thick knows little of its own.

    Returns
    -------
    tuple of float, metres
        From the largest on: means of measured radii by their precision, over beams whose radii,
        in order, are less than 12 % apart. Empty where no radius is known to 4 %.
    """
    told = [(beam.free_radius, beam.sigma_radius, beam.radius) for beam in beams]
    radii, sigmas, present = np.array(sorted(told)).reshape(-1, 3).T
    known = (sigmas > 0.0) & (sigmas <= _TRUSTED * radii)
    if rough:
        known |= (sigmas > 0.0) & (np.abs(radii - present) > _SURE * sigmas)
    radii, sigmas, present = radii[known], sigmas[known], present[known]
    if not len(radii):
        return ()
    # Rays that pass by a beam tell nothing of it, so one that is too thin grows too little.
    radii = np.where(radii > _GROWS * present, 2.0 * radii - present, radii)
    radii = np.maximum(radii, _SHRINKS * present)
    weights = 1.0 / (sigmas**2 + _FLOOR_M**2)
    order = np.argsort(radii, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(np.log(radii[order])) > np.log(_APART)) + 1)
    means = [float(np.average(radii[group], weights=weights[group])) for group in groups]
    return tuple(means[::-1])


def reclassed(beams: Sequence[Beam], radii: Sequence[float]) -> list[Beam]:
    """Give every beam the one of some radii that is nearest to what it measures.

    Parameters
    ----------
    beams : sequence of Beam
    radii : sequence of float, metres

    Returns
    -------
    list of Beam
        The axis moved as far as the radius asks for.
    """
    return [beam.resized(_nearest(beam, radii)) for beam in beams]


def _nearest(beam: Beam, radii: Sequence[float]) -> float:
    measured = beam.free_radius if np.isfinite(beam.free_radius) else beam.radius
    return min(radii, key=lambda radius: abs(np.log(radius / max(measured, 1e-3))))

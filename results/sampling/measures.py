"""Numbers about samples beside the demonstrations: in their envelope, in a gap, in which mode.

Shape letters: N samples, M demonstrations, T time points.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from results.sampling.curves import FloatArray, heights_of

Flags = NDArray[np.bool_]
Numbers = NDArray[np.int_]

#: part of the envelope's largest width by which a sample may leave it
TOLERANCE = 0.02
#: part of a category's samples that must lie in a bundle, for the bundle to be found
OWN = 0.9


def inside(samples: FloatArray, demonstrations: FloatArray) -> Flags:
    """Return which samples stay in the demonstrations' envelope, widened, at all times; (N,).

    It lies between the least and the largest demonstrated value at each time, and is widened on
    both sides by `TOLERANCE` of its largest width over time.

    :param samples: shape (N, T)
    :param demonstrations: shape (M, T)
    """
    low, high = demonstrations.min(axis=0), demonstrations.max(axis=0)
    margin = TOLERANCE * (high - low).max()
    return ((samples >= low - margin) & (samples <= high + margin)).all(axis=1)


def spanned(samples: FloatArray, demonstrations: FloatArray) -> float:
    """Return the part of the envelope's width that samples span, where it is widest, in [0, 1].

    Only the samples inside the envelope count.

    :param samples: shape (N, T)
    :param demonstrations: shape (M, T)
    """
    low, high = demonstrations.min(axis=0), demonstrations.max(axis=0)
    widest = int((high - low).argmax())
    kept = samples[inside(samples, demonstrations), widest].clip(low[widest], high[widest])
    return float(np.ptp(kept) / (high - low)[widest]) if len(kept) else 0.0


def bundle_of(samples: FloatArray, bundles: Sequence[tuple[float, float]]) -> Numbers:
    """Return the bundle of each sample, -1 between two of them and beyond, shape (N,).

    A sample is of a bundle where its height lies in the bundle's, widened by `TOLERANCE` of the
    difference between the highest and the lowest height of all bundles.

    :param samples: shape (N, T, 1)
    :param bundles: lowest and highest height of each
    """
    limits = np.array(bundles)
    margin = TOLERANCE * np.ptp(limits)
    height = heights_of(samples)[:, None]
    within = (height >= limits[:, 0] - margin) & (height <= limits[:, 1] + margin)
    return np.where(within.any(axis=1), within.argmax(axis=1), -1)


def in_gap(samples: FloatArray, bundles: Sequence[tuple[float, float]]) -> Flags:
    """Return which samples lie between two bundles and in none of them, shape (N,).

    :param samples: shape (N, T, 1)
    :param bundles: lowest and highest height of each
    """
    height, limits = heights_of(samples), np.array(bundles)
    between = (height > limits.min()) & (height < limits.max())
    return between & (bundle_of(samples, bundles) == -1)


def bundles_found(
    samples: FloatArray, categories: Numbers, bundles: Sequence[tuple[float, float]]
) -> int:
    """Return how many bundles have a category of their own, which keeps to them.

    A category does so where at least `OWN` of its samples lie in the bundle. That some samples lie
    in a bundle would tell little: a Gaussian that bridges the gaps has them too.

    :param samples: shape (N, T, 1)
    :param categories: of the samples, shape (N,)
    :param bundles: lowest and highest height of each
    """
    at = bundle_of(samples, bundles)
    found: set[int] = set()
    for category in np.unique(categories):
        chosen = at[categories == category]
        counts = np.bincount(chosen[chosen >= 0], minlength=len(bundles))
        if counts.max() >= OWN * len(chosen):
            found.add(int(counts.argmax()))
    return len(found)

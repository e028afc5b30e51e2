"""How far a trajectory is from the shape of demonstrations."""

import numpy as np
from numpy.typing import NDArray

#: share of the demonstrations' variance that their principal components hold
SHOWN_VARIANCE = 0.99


def distance_from_shapes(
    trajectory: NDArray[np.floating], demonstrations: NDArray[np.floating]
) -> float:
    """Return the root mean square distance from the demonstrations' principal subspace.

    That is the affine span of their mean and of the principal components that hold 99 % of their
    variance.

    >>> curve = np.sin(np.linspace(0.0, 3.0, 50))[:, None]
    >>> shown = np.stack([-0.2 * curve, 0.2 * curve, 0.6 * curve])
    >>> [round(distance_from_shapes(one, shown), 6) for one in (2 * curve, 2 * curve + 1)]
    [0.0, 0.416136]

    :param trajectory: shape (T, D)
    :param demonstrations: shape (N, T, D)
    """
    mean = demonstrations.mean(axis=0)
    flat = (demonstrations - mean).reshape(len(demonstrations), -1)
    _, lengths, axes = np.linalg.svd(flat, full_matrices=False)
    held = np.cumsum(lengths**2) / max(float(np.sum(lengths**2)), 1e-30)
    axes = axes[: 1 + int(np.argmax(held >= SHOWN_VARIANCE))] if lengths[0] > 0 else axes[:0]
    deviation = (trajectory - mean).ravel()
    return float(np.sqrt(np.mean((deviation - axes.T @ (axes @ deviation)) ** 2)))

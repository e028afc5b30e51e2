"""Clusters of bad samples, and the Gaussians fitted to them."""

import numpy as np
from numpy.typing import NDArray

from baselines.reps.gaussian import FloatArray


def k_means(samples: FloatArray, n_clusters: int, n_iterations: int = 50) -> NDArray[np.int_]:
    """Return each sample's cluster, shape (N,), by Lloyd's algorithm without randomness.

    The first centre is the sample farthest from the mean, each further one the sample farthest
    from the centres so far. Clusters are numbered from 0; there may be fewer than asked for where
    samples coincide.

    :param samples: shape (N, P)
    :param n_clusters: at most N are used
    :param n_iterations: at most
    """
    chosen = [int(np.argmax(np.sum((samples - samples.mean(axis=0)) ** 2, axis=1)))]
    for _ in range(min(n_clusters, len(samples)) - 1):
        nearest = _squared_distances(samples, samples[chosen]).min(axis=1)
        if nearest.max() == 0:
            break
        chosen.append(int(np.argmax(nearest)))
    centres = samples[chosen]
    labels = np.full(len(samples), -1)
    for _ in range(n_iterations):
        new = np.argmin(_squared_distances(samples, centres), axis=1)
        if np.array_equal(new, labels):
            break
        labels = new
        for i in np.unique(labels):
            centres[i] = samples[labels == i].mean(axis=0)
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def _squared_distances(samples: FloatArray, centres: FloatArray) -> FloatArray:
    return np.sum((samples[:, None] - centres[None]) ** 2, axis=2)


def fit_clusters(
    samples: FloatArray, labels: NDArray[np.int_], covariance: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the mean (P,) and covariance (P, P) of each cluster.

    A cluster has fewer samples than parameters, so its covariance is shrunk to a prior one that
    counts as P samples.

    :param samples: shape (N, P)
    :param labels: the samples' clusters, shape (N,)
    :param covariance: the prior, shape (P, P)
    """
    p, fits = samples.shape[1], []
    for i in np.unique(labels):
        members = samples[labels == i]
        mean = members.mean(axis=0)
        deviations = members - mean
        pooled = (deviations.T @ deviations + p * covariance) / (len(members) + p)
        fits.append((mean, pooled))
    return fits

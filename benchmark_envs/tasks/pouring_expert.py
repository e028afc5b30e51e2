"""The pouring expert's plan and the calibration that it aims by.

The expert tilts the cup along a minimum-jerk curve to a peak, holds it for 0.4 s, and brings it
back along another. For a larger amount the peak is higher; all else is always the same. How high
is read off `PEAKS`, which `calibrate` measured once. Marbles come in avalanches: what a plan pours
differs from the smooth relation by 18 g (standard deviation).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmark_envs.motion import minimum_jerk

FloatArray = NDArray[np.float64]

WAIT, TILT, HOLD, BACK = 0.2, 1.2, 0.4, 1.2  # s; the parts of a plan, one after the other

#: the calibration's rows: initial amounts in g
AMOUNTS = np.array([500.0, 700.0, 900.0, 1100.0, 1300.0, 1500.0])
#: its columns: poured shares of the initial amount
FRACTIONS = np.array(
    [0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.94, 0.97]
)
#: peaks of the plan's tilt in degrees, shape (6, 15)
PEAKS = np.array(
    [
        [80.5, 81.9, 83.3, 84.6, 85.4, 86.9, 88.0, 88.9, 89.7, 90.6, 91.7, 92.4, 93.6, 94.5, 95.8],
        [76.0, 77.2, 79.0, 80.7, 82.0, 84.1, 85.9, 87.4, 88.5, 89.7, 91.0, 92.0, 93.2, 94.5, 95.9],
        [71.6, 73.4, 75.7, 77.6, 78.9, 81.5, 83.8, 86.1, 87.8, 89.2, 90.7, 91.7, 92.9, 94.3, 95.7],
        [68.7, 70.2, 72.4, 74.6, 76.3, 79.1, 82.4, 84.7, 86.8, 88.6, 90.2, 91.2, 92.7, 94.4, 95.9],
        [63.1, 66.4, 68.8, 71.7, 73.5, 76.5, 80.0, 82.9, 85.7, 87.9, 90.0, 91.1, 92.8, 94.2, 95.9],
        [59.0, 63.2, 66.3, 68.7, 70.8, 74.4, 77.9, 81.2, 84.4, 87.5, 89.7, 90.8, 92.6, 94.6, 96.6],
    ]
)

TRIED = np.arange(56.0, 108.0, 0.5)  # degrees; the peaks that `calibrate` simulates
SMOOTHING = 7  # neighbouring peaks over which it averages


def plan(peak: float, times: FloatArray) -> FloatArray:
    """Return the wrist's angles at given times, shape (T, 1) in rad.

    :param peak: the largest tilt, in rad
    :param times: shape (T,) in s
    """
    there = minimum_jerk((times - WAIT) / TILT)
    back = minimum_jerk((times - WAIT - TILT - HOLD) / BACK)
    return peak * (there - back)[:, None]


def peak_tilt(initial: float, target: float) -> float:
    """Return the peak that pours about a given amount, in rad, by the calibration.

    :param initial: amount in the cup, in g
    :param target: amount to pour, in g; where it is out of the calibration's range, its nearest end
    """
    share = target / initial
    column = [float(np.interp(share, FRACTIONS, row)) for row in PEAKS]
    return float(np.radians(np.interp(initial, AMOUNTS, column)))


def calibrate(
    pour: Callable[[FloatArray, FloatArray], FloatArray],
    times: FloatArray,
    amounts: FloatArray = AMOUNTS,
) -> FloatArray:
    """Measure `PEAKS`: simulate plans over all peaks and turn the smoothed relation around.

    :param pour: simulates initial amounts (N,) in g and angles (N, T, 1) in rad, and returns what
        was poured, shape (N,) in g
    :param times: of the trajectory's time points, shape (T,) in s
    :param amounts: of the rows, shape (K,) in g
    :return: shape (K, number of `FRACTIONS`) in degrees
    """
    plans = np.stack([plan(np.radians(peak), times) for peak in TRIED])
    rows = []
    for amount in amounts:
        share = pour(np.full(len(plans), amount), plans) / amount
        padded = np.pad(share, SMOOTHING // 2, "edge")
        smooth = np.convolve(padded, np.full(SMOOTHING, 1 / SMOOTHING), "valid")
        rising = np.maximum.accumulate(smooth) + 1e-9 * np.arange(len(smooth))
        rows.append(np.interp(FRACTIONS, rising, TRIED))
    return np.array(rows, np.float64).round(1)

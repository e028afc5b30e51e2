"""DREPS: REPS that also keeps away from clusters of bad samples."""

from baselines.dreps.dreps import DREPS

__all__ = ["DREPS"]

"""Runs that Figures 5.8 and 5.9 share: two arms' networks, with Eq. 5.4's distance and without."""

from results.thesis.interface import TransferRuns

FOLDER = "transfer"
OURS, ALONE = "SkillTransfer", "two networks apart"
FULL = (TransferRuns(FOLDER, 5),)
QUICK = (TransferRuns(FOLDER, 1, shortened=0.2),)

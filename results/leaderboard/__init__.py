"""The committed leaderboard: rows, the trajectories that earned them, and what checks both."""

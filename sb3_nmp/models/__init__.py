"""The networks: neural processes over trajectories, and how a CNMP learns demonstrations."""

"""Runs and their records: what to run, running it, and the file that it leaves behind."""

"""The benchmark: run specifications, runner, aggregates, tables and plots (``nmp-bench``).

Runs produce data, one file a run; tables and plots are pure functions of those files.
"""

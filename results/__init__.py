"""The benchmark: ``nmp-bench`` runs suites and tells what came of them.

Runs produce records, one file per run; tables and figures are pure functions of records.
"""

"""Runs from other benchmarks' files, and for other benchmarks' tools."""

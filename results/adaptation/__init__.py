"""Adaptation to one held-out context after demonstrations of others."""

"""Runs of thesis 5.2.3: a skill of one robot is translated to another, which refines it."""

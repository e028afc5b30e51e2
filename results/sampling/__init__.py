"""How well samples cover the demonstrations that a network was trained on (thesis 6.2.1)."""

"""One file for each figure, table and measurement that the project reports."""

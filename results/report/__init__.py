"""From records to numbers, tables and figures; reads records and nothing else."""

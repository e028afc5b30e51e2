"""Equal tuning: the same number of trials and of tuning runs for every algorithm of a suite."""

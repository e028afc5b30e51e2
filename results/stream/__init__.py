"""Learning a policy for all contexts from a stream of them."""

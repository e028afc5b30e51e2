"""Search in one context, without demonstrations."""

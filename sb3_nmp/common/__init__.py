"""What all algorithms share: the loop, networks, noise, buffers, exceptions."""

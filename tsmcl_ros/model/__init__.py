"""What the world is like: arrays in, arrays out."""

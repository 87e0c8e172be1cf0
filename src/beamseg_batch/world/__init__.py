"""What stands in the world: members, clutter, and the files that describe them."""

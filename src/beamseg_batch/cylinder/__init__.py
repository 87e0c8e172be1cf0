"""Rays against cylinders: where a ray enters, and what its depth says about a beam."""

"""What stands in the world: members, clutter, and the files that describe them."""

from beamseg_batch.world.library import load_scene_file, world_names
from beamseg_batch.world.yaml_world import World

__all__ = ["World", "load_scene_file", "world_names"]

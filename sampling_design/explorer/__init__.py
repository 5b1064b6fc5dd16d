"""What happens when a sample moves: a time line to drag, in a browser or a notebook."""

from sampling_design.explorer.bench import Bench
from sampling_design.explorer.notebook import explore
from sampling_design.explorer.scenes import SCENES, scene
from sampling_design.explorer.server import serve

__all__ = ["SCENES", "Bench", "explore", "scene", "serve"]

"""Scene files: a body, its base, its loads, its start and its run, written in TOML.

From outside to inside: ``loading`` reads a file, ``checking`` holds it against the
``tables``, ``scene_building`` makes the scene, and ``problems`` collects whatever is
wrong, at the places that ``positions`` finds.
"""

from .loading import SceneFile as SceneFile
from .loading import builtin_scenes as builtin_scenes
from .loading import load_scene as load_scene
from .loading import scene_text as scene_text
from .problems import Problem as Problem
from .problems import SceneFileError as SceneFileError
from .tables import scene_schema as scene_schema

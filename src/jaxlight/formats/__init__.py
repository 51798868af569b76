"""Files: X3D and meshes into nodes and scenes, scenes back into X3D, images in and out."""

from .errors import SceneFileError as SceneFileError
from .errors import SceneFileWarning as SceneFileWarning
from .images import read_image as read_image
from .images import write_image as write_image
from .save import save as save
from .scene_files import ReadScene as ReadScene
from .scene_files import load as load
from .scene_files import read_nodes as read_nodes

"""Recognition: planes and what rises over the table to objects, step 11.

`planes_to_objects` is the way through. Faces come from planes (`top_faces`, `tops`, `recovery`) and, where something
rises that they do not explain, from `face_sources`: borders in space (`ledges`, `spanned_faces`, `bordered_faces`),
planes, a search (`rising_faces`, begun at `face_pieces` and at the `rising_height`) and wedges that are high on one
side (`high_sides`). `verification` decides which of them stand, `joined_faces` which two are one. `kinds` is the
library, `kind_matching` groups faces into objects, `workpieces` measures them and `grasping` says how to take hold of
them. How a face is fitted to the pictures is in `srvs_cell.vision.faces`.
"""

from srvs_cell.vision.recognition.kinds import BUILT_IN_KINDS, ObjectKind
from srvs_cell.vision.recognition.planes_to_objects import RecognitionParameters, recognise

__all__ = ["BUILT_IN_KINDS", "ObjectKind", "RecognitionParameters", "recognise"]

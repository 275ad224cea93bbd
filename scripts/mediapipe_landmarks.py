"""68 iBUG landmarks by mediapipe's face mesh, printed as landmarks.json.

mediapipe pins numpy below 2 and its own OpenCV, so it lives in an environment of its own:

    python3.11 -m venv ~/mediapipe
    ~/mediapipe/bin/pip install mediapipe==0.10.21
    ... --landmark-command "$HOME/mediapipe/bin/python scripts/mediapipe_landmarks.py"

Its mesh's points along the jaw are nearest ones, not anatomical: expect some millimetres there,
which registration finds out about; profile views find nothing and are left out.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

# Face mesh points nearest to iBUG's 68, by its published map of the mesh: jaw from the person's
# right ear, brows, nose, eyes, mouth.
JAW = [162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389]
BROWS = [70, 63, 105, 66, 107, 336, 296, 334, 293, 300]
NOSE = [168, 197, 5, 4, 75, 97, 2, 326, 305]
EYES = [33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380]
LIPS = [61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181]
INNER = [78, 82, 13, 312, 308, 317, 14, 87]
IBUG = [*JAW, *BROWS, *NOSE, *EYES, *LIPS, *INNER]


def main() -> None:
    """Read FOLDER/*.png, print landmarks."""
    import cv2
    import mediapipe

    points: dict[str, list[list[float] | None]] = {}
    with mediapipe.solutions.face_mesh.FaceMesh(
        static_image_mode=True, refine_landmarks=False
    ) as detector:
        for path in sorted(Path(sys.argv[1]).glob("*.png")):
            picture = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
            faces = detector.process(picture).multi_face_landmarks
            if not faces:
                continue
            height, width = picture.shape[:2]
            marks = faces[0].landmark
            points[path.stem] = [[marks[i].x * width, marks[i].y * height] for i in IBUG]
    print(json.dumps({"schema": "lightstage.landmarks/1", "scheme": "ibug68", "points_px": points}))


if __name__ == "__main__":
    main()

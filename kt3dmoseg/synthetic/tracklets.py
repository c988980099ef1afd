"""The moving vehicles as KITTI's ``tracklet_labels.xml``: 3D boxes in Velodyne coordinates."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.synthetic.oxts import T_CAM_VELO
from kt3dmoseg.synthetic.scene import Scene
from kt3dmoseg.types import FloatArray

_TYPES = {"car": "Car", "van": "Van", "truck": "Truck"}
_AMOUNTS = ("amt_occlusion", "amt_occlusion_kf", "amt_border_l", "amt_border_r", "amt_border_kf")
# A box stands on its origin; its x is the vehicle's forward (z), its y left (-x), its z up (-y).
_BODY_BOX = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def tracklet_xml(scene: Scene) -> str:
    """Return the document: one tracklet over all frames per moving vehicle.

    As in KITTI only the rotation about the vertical is kept; the camera's nod, under half a degree, is lost.
    """
    poses = np.stack([scene.body_poses(frame)[1:] for frame in range(scene.n_frames)])
    items = "".join(_tracklet(scene, k, poses[:, k]) for k in range(len(scene.vehicles)))
    return (
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        '<boost_serialization signature="serialization::archive" version="9">\n'
        '<tracklets class_id="0" tracking_level="0" version="0">\n'
        f"<count>{len(scene.vehicles)}</count>\n<item_version>1</item_version>\n{items}"
        "</tracklets>\n</boost_serialization>\n"
    )


def _tracklet(scene: Scene, k: int, poses: FloatArray) -> str:
    width, height, length = scene.vehicles[k].size
    places = "".join(_pose(np.linalg.inv(T_CAM_VELO) @ pose @ _BODY_BOX) for pose in poses)
    return (
        '<item class_id="1" tracking_level="0" version="1">\n'
        f"<objectType>{_TYPES[scene.vehicles[k].kind]}</objectType>\n"
        f"<h>{height}</h><w>{width}</w><l>{length}</l>\n<first_frame>0</first_frame>\n"
        '<poses class_id="2" tracking_level="0" version="0">\n'
        f"<count>{len(poses)}</count>\n<item_version>2</item_version>\n{places}</poses>\n"
        "<finished>1</finished>\n</item>\n"
    )


def _pose(box: FloatArray) -> str:
    place = "".join(f"<t{axis}>{value:.6f}</t{axis}>" for axis, value in zip("xyz", box[:3, 3], strict=True))
    yaw = np.arctan2(box[1, 0], box[0, 0])
    unknown = "".join(f"<{name}>-1</{name}>" for name in _AMOUNTS)
    return (
        f'<item class_id="3" tracking_level="0" version="2">{place}<rx>0</rx><ry>0</ry><rz>{yaw:.6f}</rz>'
        f"<state>2</state><occlusion>0</occlusion><occlusion_kf>0</occlusion_kf><truncation>0</truncation>{unknown}</item>\n"
    )

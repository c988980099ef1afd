"""Proposals from a tracklet file laid out as KITTI's, projected against numbers computed by hand.

The layout (a boost XML archive, indented with tabs; class ids on the first of its kind only; sixteen
fields per pose) is that of ``tracklet_labels.xml`` in KITTI's raw drives. The numbers are our own.
"""

from __future__ import annotations

import numpy as np
import pytest

from kt3dmoseg.annotate import Annotation, proposals
from kt3dmoseg.errors import KT3DMoSegError
from kt3dmoseg.types import Trajectories

DATE, DRIVE = "2011_09_26", "2011_09_26_drive_0005_sync"
SIZE, FIRST, FRAMES = (1242, 375), 6, 3
FOCAL, CX, CY = 700.0, 600.0, 180.0
# The camera lies 0.1 m above and 0.3 m in front of the laser scanner: x right = -y, y down = -z, z ahead = x.
CALIBRATION = {
    "calib_cam_to_cam.txt": "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n"
    + "".join(
        f"S_rect_0{c}: {SIZE[0]} {SIZE[1]}\nR_rect_0{c}: 1 0 0 0 1 0 0 0 1\n"
        f"P_rect_0{c}: {FOCAL} 0 {CX} 0 0 {FOCAL} {CY} 0 0 0 1 0\n"
        for c in range(4)
    ),
    "calib_velo_to_cam.txt": "calib_time: 15-Mar-2012 11:37:16\nR: 0 -1 0 0 0 -1 1 0 0\nT: 0 0.1 -0.3\n",
    "calib_imu_to_velo.txt": "calib_time: 25-May-2012 16:47:16\nR: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n",
}
HEAD = """<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
\t<count>{count}</count>
\t<item_version>1</item_version>
"""
TAIL = """</tracklets>
</boost_serialization>

"""
FLAGS = {
    "occlusion_kf": 1,
    "truncation": 0,
    "amt_occlusion": 0,
    "amt_occlusion_kf": 1,
    "amt_border_l": 0,
    "amt_border_r": 1,
    "amt_border_kf": -1,
}


def pose(position, class_id, occlusion=0):
    x, y, yaw = position
    fields = {"tx": x, "ty": y, "tz": -1.5, "rx": 0, "ry": 0, "rz": yaw, "state": 2, "occlusion": occlusion}
    lines = "".join(f"\t\t\t\t<{name}>{value}</{name}>\n" for name, value in (fields | FLAGS).items())
    return f"\t\t\t<item{class_id}>\n{lines}\t\t\t</item>\n"


def tracklet(kind, size, first, positions, occlusions=None, *, leads=False):
    """One object; the first of a file carries the class ids."""
    length, width, height = size
    ids = [f' class_id="{k}" tracking_level="0" version="{v}"' for k, v in ((1, 1), (2, 0), (3, 2))]
    item, poses, entry = ids if leads else ("", "", "")
    hidden = occlusions or [0] * len(positions)
    rows = "".join(pose(position, "" if k else entry, hidden[k]) for k, position in enumerate(positions))
    return (
        f"\t<item{item}>\n\t\t<objectType>{kind}</objectType>\n\t\t<h>{height}</h>\n\t\t<w>{width}</w>\n"
        f"\t\t<l>{length}</l>\n\t\t<first_frame>{first}</first_frame>\n\t\t<poses{poses}>\n"
        f"\t\t\t<count>{len(positions)}</count>\n\t\t\t<item_version>2</item_version>\n{rows}\t\t</poses>\n"
        "\t\t<finished>1</finished>\n\t</item>\n"
    )


CAR = tracklet("Car", (4.0, 2.0, 1.5), FIRST, [(20.0, 2.0, 0.0), (22.0, 2.0, 0.0)], leads=True)
PARKED = tracklet("Van", (4.0, 2.0, 2.0), 0, [(15.0, -6.0, 0.0)] * 20)
WALKER = tracklet(
    "Pedestrian", (1.0, 1.0, 2.0), FIRST, [(10.0, y, np.pi / 2) for y in (3.0, 1.0, -1.0)], [0, 2, 1]
)
SITTING = tracklet("Person (sitting)", (1.0, 1.0, 1.0), 40, [(10.0, 0.0, 0.0)])


def write_drive(root, text, *, poses=True):
    files = {f"{DATE}/{name}": content for name, content in CALIBRATION.items()}
    files[f"{DATE}/{DRIVE}/tracklet_labels.xml"] = text
    for number in range(20):
        files[f"{DATE}/{DRIVE}/image_00/data/{number:010d}.png"] = ""
        if poses:  # the camera car waits
            rest = " ".join(["0.0"] * 22)
            files[f"{DATE}/{DRIVE}/oxts/data/{number:010d}.txt"] = f"49.0 8.4 112.5 0 {rest} 4 9 4 4\n"
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)


def ask(root):
    folder = root / DATE / DRIVE / "image_00" / "data"
    frames = tuple(folder / f"{number:010d}.png" for number in range(FIRST, FIRST + FRAMES))
    none = Trajectories(np.zeros((1, FRAMES, 2)), np.ones((1, FRAMES), bool))
    asked = proposals.Request("clip", Annotation("clip", SIZE, FRAMES), none, frames, kitti=root)
    return proposals.propose("tracklets", asked)


def document(*items):
    return HEAD.format(count=len(items)) + "".join(items) + TAIL


def corners(item, frame):
    (key,) = (key for key in item.key_frames if key.frame == frame)
    return {(round(x, 2), round(y, 2)) for x, y in key.polygons[0]}


def test_a_car_ahead_projects_as_computed_by_hand(tmp_path):
    write_drive(tmp_path, document(CAR))
    (car,) = ask(tmp_path)
    assert (car.name, car.kind, car.motion, car.note) == ("car 1", "car", 1, "from a KITTI tracklet")
    # Laser: x 18..22, y 1..3, z -1.5..0. Camera: X -3..-1, Y 0.1..1.6, Z 17.7..21.7.
    near, far = 17.7, 21.7
    left, inner = CX - 3 * FOCAL / near, CX - 1 * FOCAL / near
    right, middle = CX - 1 * FOCAL / far, CX - 3 * FOCAL / far
    low, high = CY + 1.6 * FOCAL / near, CY + 0.1 * FOCAL / near
    top, bottom = CY + 0.1 * FOCAL / far, CY + 1.6 * FOCAL / far
    assert (round(left, 1), round(right, 1)) == (481.4, 567.7)
    hull = [(left, low), (inner, low), (right, bottom), (right, top), (middle, top), (left, high)]
    assert corners(car, 0) == {(round(x, 2), round(y, 2)) for x, y in hull}
    shown = [(key.frame, key.visibility) for key in car.key_frames]
    assert shown == [(0, "visible"), (1, "visible"), (2, "outside")]


def test_what_is_parked_is_left_out_where_the_drive_has_poses(tmp_path):
    text = document(CAR, PARKED, WALKER, SITTING)
    write_drive(tmp_path, text)
    found = ask(tmp_path)
    assert [(item.kind, item.motion) for item in found] == [("car", 1), ("pedestrian", 2)]
    assert [k.visibility for k in found[1].key_frames] == ["visible", "occluded", "visible"]
    write_drive(tmp_path / "blind", text, poses=False)
    assert [item.kind for item in ask(tmp_path / "blind")] == ["car", "van", "pedestrian"]


ENTITIES = '<!DOCTYPE boost_serialization [<!ENTITY a "Car"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
GOOD = document(CAR)


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace("<!DOCTYPE boost_serialization>", ENTITIES).replace("Car", "&b;"),
        GOOD.replace(
            "<!DOCTYPE boost_serialization>", '<!DOCTYPE b [<!ENTITY a SYSTEM "file:///etc/passwd">]>'
        ),
        GOOD[: len(GOOD) // 2],
        GOOD.replace(f"<first_frame>{FIRST}", "<first_frame>" + "9" * 40),
        GOOD.replace(f"<first_frame>{FIRST}", "<first_frame>-3"),
        GOOD.replace("<l>4.0", "<l>nan"),
        GOOD.replace("<l>4.0", "<l>-4"),
        GOOD.replace("<tx>20.0", "<tx>1e999"),
        GOOD.replace("<state>2", "<state>" + "9" * 40),
        GOOD.replace("<rz>0.0</rz>", ""),
        "<boost_serialization></boost_serialization>",
        "",
    ],
)
def test_damaged_and_hostile_files_are_one_line(tmp_path, text):
    write_drive(tmp_path, text)
    with pytest.raises(KT3DMoSegError) as caught:
        ask(tmp_path)
    assert "tracklet_labels.xml" in str(caught.value)
    assert "\n" not in str(caught.value)

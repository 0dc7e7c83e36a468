"""Checks with other people's readers what press.sh made of one press. Usage: check_press.py FOLDER."""

import json
import sys
from pathlib import Path

import numpy as np
import published

CAPTURE = "demo-0001"
SUBJECT = "1884.3"


def passed(what):
    print(f"passed: from a press: {what}", flush=True)


def main(home):
    import bagit
    import pycolmap
    import trimesh

    bag = bagit.Bag(str(home / "package"))
    bag.validate()
    names = list(bag.entries)
    for ending in ("recordings/demo.mcap", "recordings/demo.notes.jsonl", f"{CAPTURE}/model.glb", f"{CAPTURE}.html"):
        assert any(name.endswith(ending) for name in names), f"{ending}: {names}"
    sheet = json.loads((home / "package/data/paradata/demo" / f"{CAPTURE}.json").read_text())
    assert sheet["object"]["number"] == SUBJECT and sheet["by_whom"]["operator"] == "Zacharias"
    assert sheet["by_whom"]["notes"]["decision"] == "accepted"
    passed(f"bagit: a valid package of {len(names)} files")

    (model,) = (home / "models").rglob("model.glb")
    full = trimesh.load(model, force="mesh", process=False)
    less = trimesh.load(home / "exported" / f"{CAPTURE}-lod1.glb", force="mesh", process=False)
    for mesh, share in ((full, 1), (less, 0.25)):
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        assert mesh.is_watertight
        assert abs(len(mesh.faces) / len(full.faces) / share - 1) < 0.1
    assert 0.05 < np.ptp(full.vertices[:, 1]) < 0.15, "a cup of 95 mm, y up"
    asset = json.loads(glb_json(model))["asset"]["extras"]
    assert asset["subject"] == SUBJECT and asset["operator"] == "Zacharias"
    passed(f"trimesh: a closed model of {len(full.faces)} triangles, and a level of detail")

    scene = pycolmap.Reconstruction(str(home / "colmap" / CAPTURE / "sparse/0"))
    assert scene.num_reg_images() == 11 and scene.num_points3D() > 100, scene.summary()
    errors = [
        np.linalg.norm(image.project_point(scene.points3D[seen.point3D_id].xyz) - seen.xy)
        for image in scene.images.values()
        for seen in image.get_observation_points2D()
    ]
    assert max(errors) < 0.1
    passed(f"pycolmap: {scene.num_reg_images()} pictures, {len(errors)} observations within {max(errors):.6f} px")

    published.check(home / "site", "https://museum.example/3d/", ["Zacharias", CAPTURE, "loopback"], passed)


def glb_json(path):
    content = path.read_bytes()
    return content[20 : 20 + int.from_bytes(content[12:16], "little")]


main(Path(sys.argv[1]))

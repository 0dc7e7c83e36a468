"""Checks with larger programs of other people what run.sh made. Usage: check_large.py FOLDER READER, one
reader a process, because they bring libraries of the same names. Prints a line with the reader's version if it passed."""

import os
import sys
from pathlib import Path

import numpy as np

CAPTURE = "cup-000"
# Of the simulated cup, in metres.
HEIGHT = 0.095


def passed(what):
    print(f"passed: {what}", flush=True)


def near(found, expected, relative, what):
    assert abs(found / expected - 1) <= relative, f"{what}: {found}, expected {expected}"


def with_open3d(home):
    import open3d

    ply = open3d.io.read_triangle_mesh(str(home / "out/cup" / CAPTURE / "model.ply"))
    # Its own is_watertight also looks for triangles that cross, which takes minutes.
    assert ply.is_edge_manifold(allow_boundary_edges=False) and ply.is_vertex_manifold()
    assert ply.has_vertex_colors() and ply.has_vertex_normals()
    near(np.ptp(np.asarray(ply.vertices)[:, 2]), HEIGHT, 0.03, "height of .ply")
    for ending in ("glb", "obj", "stl"):
        mesh = open3d.io.read_triangle_mesh(str(home / f"export/{CAPTURE}.{ending}"))
        assert len(mesh.triangles) == len(ply.triangles), ending
        scale, up = (1000, 2) if ending == "stl" else (1, 1)
        near(np.ptp(np.asarray(mesh.vertices)[:, up]), HEIGHT * scale, 0.03, f"height of .{ending}")
        assert ending == "stl" or mesh.has_triangle_uvs(), ending
    points = open3d.io.read_point_cloud(str(home / "nerfstudio" / CAPTURE / "points.ply"))
    assert len(points.points) > 500 and points.has_colors()
    passed(f"open3d {open3d.__version__}: PLY, GLB, OBJ and STL, and the points of a dataset for nerfstudio")


def with_meshlab(home):
    import pymeshlab

    for name, scale in (("out/cup/" + CAPTURE + "/model.ply", 1), (f"export/{CAPTURE}.stl", 1000), (f"export/{CAPTURE}.3mf", 1000)):
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(str(home / name))
        meshes.apply_filter("meshing_merge_close_vertices", threshold=pymeshlab.PureValue(1e-9 * scale))
        found = meshes.get_topological_measures()
        assert found["is_mesh_two_manifold"] and found["number_holes"] == 0, (name, found)
        near(meshes.current_mesh().bounding_box().dim_z(), HEIGHT * scale, 0.03, f"height of {name}")
    passed(f"pymeshlab {pymeshlab.__version__ if hasattr(pymeshlab, '__version__') else '2025.7'}: PLY, STL and 3MF are closed and manifold")


def with_blender(home):
    import bpy

    for name in (f"export/{CAPTURE}.glb", f"small/{CAPTURE}.glb", f"site/{published(home)}/medium.glb"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.import_scene.gltf(filepath=str(home / name))
        (model,) = [thing for thing in bpy.data.objects if thing.type == "MESH"]
        near(model.dimensions.z, HEIGHT, 0.03, f"height of {name}")
        attributes = {attribute.name for attribute in model.data.attributes}
        assert {"_PROVENANCE", "_ERROR", "_SEEN"} <= attributes, (name, attributes)
        assert len(bpy.data.images) >= 1 and bpy.data.images[0].size[0] > 16, name
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.usd_import(filepath=str(home / f"export/{CAPTURE}.usdz"))
    (model,) = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    # Blender's z is up, to which the object, and not its numbers, is turned.
    heights = [(model.matrix_world @ vertex.co).z for vertex in model.data.vertices]
    near(max(heights) - min(heights), HEIGHT, 0.03, "height of .usdz")
    passed(f"Blender {bpy.app.version_string}: GLB whole, compressed and published, and USDZ: metres, attributes, texture")


def with_rerun(home):
    import subprocess

    import rerun

    from scand import Recording
    from scand.to_rerun import convert

    program = Path(rerun.__file__).parents[1] / "rerun_cli" / "rerun"
    program = program if program.is_file() else Path(rerun.__file__).parents[2] / "rerun_cli" / "rerun"
    convert(home / "cup.mcap", home / "cup.rrd", home / "out")
    done = subprocess.run([program, "rrd", "print", "-vv", home / "cup.rrd"], capture_output=True, text=True, check=True)
    said = done.stdout + done.stderr
    for wanted in ("DepthImage:buffer", "DepthImage:meter", "Pinhole:image_from_camera", "Transform3D:translation", "Mesh3D:vertex_positions"):
        assert wanted in said, wanted
    for capture in Recording(home / "cup.mcap").captures():
        for camera in (*(f"color/{id}" for id in capture.colors), *(f"depth/{id}" for id in capture.depths)):
            assert f"/rig/{camera}" in said, camera
    passed(f"Rerun {rerun.__version__}: depth as depth, lenses, poses, pictures and a model")


def with_nerfstudio(home):
    """nerfstudio's own parser reads the dataset, and its cameras see the points where the masks have the object."""
    from importlib.metadata import version

    from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig
    from PIL import Image, ImageFilter

    config = NerfstudioDataParserConfig(
        data=(home / "nerfstudio" / CAPTURE).absolute(),
        orientation_method="none",
        center_method="none",
        auto_scale_poses=False,
        eval_mode="all",
        load_3D_points=True,
    )
    parsed = config.setup().get_dataparser_outputs(split="train")
    cameras, points = parsed.cameras, parsed.metadata["points3D_xyz"].numpy()
    assert len(parsed.image_filenames) == len(parsed.mask_filenames) == len(cameras) == 8
    assert len(points) > 500
    near(np.ptp(points[:, 2]), HEIGHT, 0.03, "height of the points")
    for index, name in enumerate(parsed.mask_filenames):
        rotation, position = np.split(cameras.camera_to_worlds[index].numpy(), [3], axis=1)
        x, y, z = ((points - position[:, 0]) @ rotation).T
        u = cameras.fx[index].item() * x / -z + cameras.cx[index].item()
        v = cameras.fy[index].item() * -y / -z + cameras.cy[index].item()
        # Points of the outline may lie up to a pixel beside it.
        mask = np.asarray(Image.open(name).filter(ImageFilter.MaxFilter(3)))
        rows = np.clip(v.astype(int), 0, mask.shape[0] - 1)
        columns = np.clip(u.astype(int), 0, mask.shape[1] - 1)
        inside = np.mean(mask[rows, columns] == 255)
        assert inside > 0.995, f"{name.stem}: {inside:.3f} of the points are in the mask"
    passed(f"nerfstudio {version('nerfstudio')}: its parser reads pictures, masks, poses and {len(points)} points")


def published(home):
    (folder,) = sorted((home / "site/objects").iterdir())[:1]
    return folder.relative_to(home / "site")


READERS = {"open3d": with_open3d, "meshlab": with_meshlab, "rerun": with_rerun, "blender": with_blender, "nerfstudio": with_nerfstudio}

READERS[sys.argv[2]](Path(sys.argv[1]))
sys.stdout.flush()
# Blender as a module ends with a crash otherwise.
os._exit(0)

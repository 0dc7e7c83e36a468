"""Checks with other people's readers what run.sh made. Usage: check.py FOLDER. Prints a line for each check that passed;
ends with an error at the first that fails."""

import json
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import published
from entitle import TITLE

import scand

CAPTURE = "cup-000"


def passed(what):
    print(f"passed: {what}", flush=True)


def close(found, expected, relative, what):
    assert abs(found / expected - 1) <= relative, f"{what}: {found}, expected {expected}"


def read_with_scand(home):
    """The Python reader: models, report and recording agree with each other."""
    folder = home / "out/cup" / CAPTURE
    ply, glb = scand.read_model(folder), scand.read_model(folder / "model.glb")
    close(ply.volume(), glb.volume(), 1e-5, "volume of .ply and .glb")
    assert ply.about["capture"] == glb.about["capture"] == CAPTURE
    assert ply.about["title"] == glb.about["title"] == TITLE
    assert glb.texture[:2] == b"\xff\xd8"
    assert len(ply.provenance) == len(ply.vertices) and ply.provenance.max() < len(scand.PROVENANCES)
    assert np.isfinite(ply.expected_error).all() and (ply.expected_error > 0).all()
    assert (ply.provenance == scand.RESTORED).any(), "the cup's inside is restored"
    report = scand.read_report(folder)
    assert report["verdict"]["level"] in ("green", "amber", "red")
    captures = {capture.id: capture for capture in scand.Recording(home / "cup.mcap").captures()}
    capture = captures[CAPTURE]
    assert len(captures) == 2 and capture.decision() == "accept"
    assert len(capture.colors) == 8 and len(capture.depths) == 1
    for view in capture.colors.values():
        assert view.picture.shape[:2] == (view.lens.height, view.lens.width)
    for view in capture.depths.values():
        metres = view.metres(view.readings)
        assert metres.shape == view.readings.shape and 0.2 < np.nanmedian(metres) < 3
    passed("python/scand: model, report and recording")
    return ply, capture


def volume(vertices, triangles):
    a, b, c = (np.asarray(vertices, float)[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def with_trimesh(home, model):
    """Units, axes, texture and watertightness of OBJ, STL and glTF."""
    import trimesh

    # Its reader of headers takes ASCII alone.
    plain = trimesh.load(home / "out/cup" / CAPTURE / "model.ply", process=False)
    close(plain.volume, model.volume(), 1e-5, "model.ply: volume")
    height = np.ptp(model.vertices[:, 2])
    for ending, scale, up in (("obj", 1, 1), ("glb", 1, 1), ("stl", 1000, 2)):
        for name in (CAPTURE, f"{CAPTURE}-lod1"):
            mesh = trimesh.load(home / f"export/{name}.{ending}", force="mesh", process=False)
            near = 1e-4 if name == CAPTURE else 0.02
            close(volume(mesh.vertices, mesh.faces), model.volume() * scale**3, near, f"{name}.{ending}: volume")
            close(np.ptp(mesh.vertices[:, up]), height * scale, near, f"{name}.{ending}: height")
            welded = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
            welded.merge_vertices(merge_tex=True, merge_norm=True)
            assert welded.is_watertight, f"{name}.{ending} is not watertight"
            if ending != "stl":
                image = getattr(mesh.visual.material, "image", None) or mesh.visual.material.baseColorTexture
                assert image.size[0] > 16, f"{name}.{ending} has no texture"
                if name == CAPTURE:
                    colors(mesh, image, model, name + "." + ending)
    passed("trimesh: OBJ, STL and GLB, whole and at a level of detail: units, axes, texture, watertight")
    small = trimesh.load(home / f"small/{CAPTURE}.glb", force="mesh", process=False)
    close(volume(small.vertices, small.faces), model.volume(), 1e-3, "compressed glb: volume")
    sizes = [(home / folder / f"{CAPTURE}.glb").stat().st_size for folder in ("export", "small")]
    assert sizes[1] < sizes[0]
    passed(f"trimesh: compressed GLB, {sizes[1] / sizes[0]:.2f} of the size")


def colors(mesh, image, model, name):
    """The texture at each vertex is near the colour that the .ply has there."""
    pixels = np.asarray(image.convert("RGB"), float)
    uv = np.clip(mesh.visual.uv, 0, 1)
    x = np.minimum((uv[:, 0] * pixels.shape[1]).astype(int), pixels.shape[1] - 1)
    y = np.minimum(((1 - uv[:, 1]) * pixels.shape[0]).astype(int), pixels.shape[0] - 1)
    z_up = np.stack([mesh.vertices[:, 0], -mesh.vertices[:, 2], mesh.vertices[:, 1]], axis=1).astype(float)
    places = {tuple(p): c for p, c in zip(np.round(model.vertices.astype(float), 5), model.colors.astype(float))}
    pairs = [(pixels[y[i], x[i]], places[key]) for i, p in enumerate(np.round(z_up, 5)) if (key := tuple(p)) in places]
    assert len(pairs) > 100, f"{name}: {len(pairs)} vertices are those of the .ply"
    off = np.median([np.abs(a - b).mean() for a, b in pairs])
    assert off < 12, f"{name}: colours are off by {off}"


def with_lib3mf(home, model):
    """The reference reader of 3MF: no warnings, millimetres, a solid with texture."""
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    for name, near in ((CAPTURE, 1e-4), (f"{CAPTURE}-lod1", 0.02)):
        document = wrapper.CreateModel()
        reader = document.QueryReader("3mf")
        reader.SetStrictModeActive(True)
        reader.ReadFromFile(str(home / f"export/{name}.3mf"))
        warnings = [reader.GetWarning(i) for i in range(reader.GetWarningCount())]
        assert not warnings, warnings
        assert document.GetUnit() == lib3mf.ModelUnit.MilliMeter
        meshes = document.GetMeshObjects()
        assert meshes.MoveNext()
        mesh = meshes.GetCurrentMeshObject()
        assert mesh.IsManifoldAndOriented(), f"{name}.3mf is no solid"
        vertices = np.array([list(v.Coordinates) for v in mesh.GetVertices()])
        triangles = np.array([list(t.Indices) for t in mesh.GetTriangleIndices()])
        close(volume(vertices, triangles), model.volume() * 1e9, near, f"{name}.3mf: volume")
        assert document.GetTexture2Ds().Count() == 1
        said = document.GetMetaDataGroup()
        texts = [said.GetMetaData(i).GetValue() for i in range(said.GetMetaDataCount())]
        assert any(TITLE in text for text in texts), texts
    passed("lib3mf: 3MF in strict mode: millimetres, a solid, texture")


def with_usd(home, model):
    """OpenUSD: the package's own rules, metres, y up, texture."""
    from pxr import Usd, UsdGeom, UsdShade, UsdValidation

    rules = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    for name, near in ((CAPTURE, 1e-4), (f"{CAPTURE}-lod1", 0.02)):
        path = str(home / f"export/{name}.usdz")
        stage = Usd.Stage.Open(path)
        said = stage.GetRootLayer().customLayerData
        assert said["title"] == TITLE, said
        problems = [f"{e.GetName()}: {e.GetMessage()}" for e in rules.Validate(stage)]
        assert not problems, problems
        assert UsdGeom.GetStageMetersPerUnit(stage) == 1 and UsdGeom.GetStageUpAxis(stage) == "Y"
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Model/Surface"))
        points = np.array(mesh.GetPointsAttr().Get())
        triangles = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        close(volume(points, triangles), model.volume(), near, f"{name}.usdz: volume")
        close(np.ptp(points[:, 1]), np.ptp(model.vertices[:, 2]), near, f"{name}.usdz: height")
        primvars = UsdGeom.PrimvarsAPI(mesh)
        assert len(primvars.GetPrimvar("st").ComputeFlattened()) == triangles.size
        assert len(primvars.GetPrimvar("expectedError").Get()) == len(points)
        material, _ = UsdShade.MaterialBindingAPI(mesh.GetPrim()).ComputeBoundMaterial()
        assert material and material.ComputeSurfaceSource()[0]
        with zipfile.ZipFile(path) as package:
            assert package.testzip() is None
            for entry in package.infolist():
                local = Path(path).read_bytes()[entry.header_offset : entry.header_offset + 30]
                start = entry.header_offset + 30 + sum(struct.unpack("<HH", local[26:30]))
                assert start % 64 == 0 and entry.compress_type == zipfile.ZIP_STORED
    passed("usd-core: USDZ: metres, y up, texture, aligned")


def reprojection(capture, points, pixels_of, what):
    """How far pixels of a dataset are from where the recording's calibration sees the points, through its lens."""
    farthest, count = 0.0, 0
    for id, view in capture.colors.items():
        pixels = pixels_of(id, points)
        if pixels is None:
            continue
        camera = (np.c_[points, np.ones(len(points))] @ np.linalg.inv(view.rig_from_camera).T)[:, :3]
        expected = view.lens.project(camera)
        # The dataset's camera has no distortion: the lens takes its pixel to where the camera saw the point.
        focal, centre = np.diag(view.lens.matrix)[:2], view.lens.matrix[:2, 2]
        ahead = np.c_[(pixels - centre) / focal, np.ones(len(pixels))]
        farthest = max(farthest, np.abs(view.lens.project(ahead) - expected).max())
        count += len(points)
    assert count > 1000 and farthest < 0.1, f"{what}: {farthest} px over {count} projections"
    passed(f"{what}: reprojection within {farthest:.6f} px, {count} projections")


def with_pycolmap(home, capture):
    """COLMAP's own reader: cameras, poses and points; its projections agree with the recording's calibration."""
    import pycolmap

    scene = pycolmap.Reconstruction(str(home / "colmap" / CAPTURE / "sparse/0"))
    assert scene.num_reg_images() == 8 and scene.num_points3D() > 500, scene.summary()
    points = np.array([point.xyz for point in scene.points3D.values()])[:2000]
    images = {image.name: image for image in scene.images.values()}

    def pixels(id, points):
        image = images[f"{id}.png"]
        # COLMAP's first pixel has its centre at half.
        return np.array([image.project_point(point) for point in points]) - 0.5

    reprojection(capture, points, pixels, "pycolmap")
    errors = []
    for image in scene.images.values():
        for observed in image.get_observation_points2D():
            projected = image.project_point(scene.points3D[observed.point3D_id].xyz)
            errors.append(np.linalg.norm(projected - observed.xy))
        folder = home / "colmap" / CAPTURE
        assert (folder / "images" / image.name).is_file() and (folder / "masks" / f"{image.name}.png").is_file()
    assert max(errors) < 1e-3, max(errors)
    passed(f"pycolmap: {len(errors)} observations of points")


def with_nerfstudio_rules(home, capture, points):
    """transforms.json by its published convention, read here: nerfstudio itself is too large for this check."""
    folder = home / "nerfstudio" / CAPTURE
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    by_name = {Path(frame["file_path"]).stem: frame for frame in frames}

    def pixels(id, points):
        frame = by_name[id]
        world = np.linalg.inv(frame["transform_matrix"])
        x, y, z = (np.c_[points, np.ones(len(points))] @ world.T)[:, :3].T
        u, v = frame["fl_x"] * x / -z + frame["cx"], frame["fl_y"] * -y / -z + frame["cy"]
        return np.c_[u, v] - 0.5

    reprojection(capture, points, pixels, "transforms.json")
    from PIL import Image

    for frame in frames:
        picture, mask = (Image.open(folder / frame[key]) for key in ("file_path", "mask_path"))
        assert picture.size == mask.size == (frame["w"], frame["h"])
        assert mask.mode == "L" and set(np.unique(mask)) == {0, 255}
    passed("Pillow: undistorted pictures and masks")


def with_bagit(home):
    """The Library of Congress's reader accepts the package, and notices a changed file."""
    import bagit

    bag = bagit.Bag(str(home / "package"))
    bag.validate()
    assert bag.algorithms == ["sha512"] and bag.info["Bagging-Date"] == "2026-01-31"
    assert any(path.endswith("cup.mcap") for path in bag.entries)
    victim = home / "package" / "data" / "README.txt"
    whole = victim.read_bytes()
    victim.write_bytes(whole[:-1] + b"!")
    assert not bag.is_valid()
    victim.write_bytes(whole)
    passed("bagit: the package for an archive is valid, and a changed file is noticed")


def main(home):
    model, capture = read_with_scand(home)
    with_bagit(home)
    with_trimesh(home, model)
    with_lib3mf(home, model)
    with_usd(home, model)
    with_pycolmap(home, capture)
    with_nerfstudio_rules(home, capture, model.vertices[::20].astype(float))
    # The note's author, and the recording's name, which its captures have too.
    published.check(home / "site", "https://museum.example/3d/", ["Zacharias", "cup-000", "cup.mcap"], passed)


main(Path(sys.argv[1]))

"""Checks a folder that `scand publish --address` made: its manifests with IIIF's own models of the standard (iiif-prezi3), its
models with trimesh, its pages with Python's parser of HTML, and its scenes by the rules of Voyager's schema, read here:
Voyager itself is in no registry. What must stay out is looked for in every byte."""

import json
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from urllib.parse import urlparse

LINKS = ["rendering", "thumbnail", "seeAlso", "homepage"]
QUALITIES = ["High", "Medium", "Low", "Thumb"]


class Page(HTMLParser):
    """The addresses and the scripts of a page."""

    def __init__(self, text):
        super().__init__()
        self.addresses, self.inline, self.policy, self.open = [], [], "", ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        assert not any(name.startswith("on") or name == "style" for name in known), (tag, attributes)
        self.addresses += [known[name] for name in ("src", "href") if known.get(name)]
        if known.get("http-equiv") == "Content-Security-Policy":
            self.policy = known["content"]
        self.open = tag

    def handle_data(self, data):
        if self.open == "script" and data.strip():
            self.inline.append(data)


def pages(site):
    """Every page loads only files of the folder; the number of pages."""
    found = sorted(site.rglob("*.html"))
    for path in found:
        page = Page(path.read_text())
        assert page.policy.startswith("default-src 'none'") and not page.inline, path
        for address in page.addresses:
            assert not urlparse(address).scheme and not address.startswith("/"), (path, address)
            assert (path.parent / address).resolve().is_relative_to(site.resolve()), (path, address)
            assert (path.parent / address).is_file(), (path, address)
    return len(found)


def manifests(site, address):
    """Every manifest is one for iiif-prezi3, and each of its addresses is a file of the folder; the number of manifests."""
    from iiif_prezi3 import Collection, Manifest

    def in_folder(found):
        assert found.startswith(address), found
        assert (site / found[len(address) :]).is_file(), found

    collection = Collection(**json.loads((site / "collection.json").read_text()))
    for item in collection.items:
        in_folder(str(item.id))
        text = (site / str(item.id)[len(address) :]).read_text()
        manifest = Manifest(**json.loads(text))
        bodies = [canvas.items[0].items[0].body for canvas in manifest.items]
        assert [body.type for body in bodies] == ["Model", "Image"], bodies
        assert bodies[0].format == "model/gltf-binary"
        for resource in bodies + [each for name in LINKS for each in resources(getattr(manifest, name))]:
            in_folder(str(resource.id))
        # What the library writes again is what it read.
        again = json.loads(manifest.json())
        assert again["label"] == json.loads(text)["label"] and len(again["items"]) == 2
    return len(collection.items)


def resources(found):
    """The resources of a property; the library wraps some of them."""
    found = getattr(found, "root", found)
    return [getattr(each, "root", each) for each in found]


def scenes(site):
    """Every scene has the members that Voyager's schema asks for, and its derivatives are files that are as it says."""
    import trimesh

    for path in sorted(site.rglob("scene.svx.json")):
        scene = json.loads(path.read_text())
        assert scene["asset"]["type"] == "application/si-dpo-3d.document+json" and scene["asset"]["version"]
        root = scene["scenes"][scene["scene"]]
        model = scene["models"][scene["nodes"][root["nodes"][0]]["model"]]
        assert model["units"] == "m"
        low, high = model["boundingBox"]["min"], model["boundingBox"]["max"]
        derivatives = model["derivatives"]
        # High.glb alone would be a model without levels of detail.
        assert len(derivatives) >= 2, f"{path}: {len(derivatives)} level of detail"
        assert [d["quality"] for d in derivatives] == QUALITIES[: len(derivatives)]
        named = {asset["uri"] for derivative in derivatives for asset in derivative["assets"]}
        assert named == {file.name for file in path.parent.glob("*.glb")}, named
        faces = [asset["numFaces"] for derivative in derivatives for asset in derivative["assets"]]
        assert all(less < more / 2 for more, less in pairwise(faces)), faces
        for derivative in derivatives:
            (asset,) = derivative["assets"]
            file = path.parent / asset["uri"]
            assert derivative["usage"] == "Web3D" and asset["type"] == "Model"
            assert asset["byteSize"] == file.stat().st_size
            mesh = trimesh.load(file, force="mesh", process=False)
            assert len(mesh.faces) == asset["numFaces"], file
            for axis in range(3):
                size = high[axis] - low[axis]
                assert abs(mesh.bounds[0][axis] - low[axis]) < 0.02 * size + 1e-4, (file, mesh.bounds, low)
                assert abs(mesh.bounds[1][axis] - high[axis]) < 0.02 * size + 1e-4, (file, mesh.bounds, high)
        for image in scene["metas"][root["meta"]]["images"]:
            assert (path.parent / image["uri"]).stat().st_size == image["byteSize"]


def check(site, address, hidden, passed):
    """All of it; `hidden` are words that no byte of the folder may have."""
    site = Path(site)
    for path in site.rglob("*"):
        if path.is_file() and path.name != "viewer.js":
            content = path.read_bytes()
            for word in hidden:
                assert word.encode() not in content, f"{path}: {word}"
    passed(f"published folder: {pages(site)} pages load nothing from elsewhere; nothing hidden is in it")
    passed(f"iiif-prezi3: {manifests(site, address)} manifests and a collection")
    scenes(site)
    passed("trimesh: the levels of detail of each scene for Voyager")

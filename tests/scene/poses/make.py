"""Writes the files of this folder: animated glTF files, and where their triangles are at some moments.

    pip install numpy bpy
    python3 make.py [Fox.glb]

An implementation in numpy, which shares nothing with Penumbra, decides what a pose is. Blender's importer (module bpy)
confirms it at the times of keys: between them Blender interpolates quaternions by component, and it ignores the
tangents of splines. Fox.glb is a sample model of Khronos, https://github.com/KhronosGroup/glTF-Sample-Assets.
"""

import base64
import json
import math
import os
import struct
import sys

import numpy as np

FOLDER = os.path.dirname(os.path.abspath(__file__))
# Of the size of the scene.
TOLERANCE = 1e-5
TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Builder:
    """A glTF file under construction."""

    def __init__(self):
        self.json = {"asset": {"version": "2.0"}, "buffers": [], "bufferViews": [], "accessors": []}
        self.bytes = b""

    def view(self, array):
        self.bytes += b"\0" * (-len(self.bytes) % 4)
        view = {"buffer": 0, "byteOffset": len(self.bytes), "byteLength": array.nbytes}
        self.json["bufferViews"].append(view)
        self.bytes += array.tobytes()
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values, kind, dtype=np.float32, normalised=False, bounds=False):
        array = np.ascontiguousarray(values, dtype)
        code = next(code for code, own in TYPES.items() if own == dtype)
        accessor = {"bufferView": self.view(array), "componentType": code, "type": kind}
        accessor["count"] = array.size // WIDTHS[kind]
        if normalised:
            accessor["normalized"] = True
        if bounds:
            rows = array.reshape(-1, WIDTHS[kind])
            accessor["min"], accessor["max"] = rows.min(0).tolist(), rows.max(0).tolist()
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def sparse(self, count, rows, values):
        """Displacements that are zero but for some rows."""
        indices, values = self.view(np.array(rows, np.uint16)), self.view(np.array(values, np.float32))
        low, high = [0.0] * 3, [0.0] * 3
        sparse = {
            "count": len(rows),
            "indices": {"bufferView": indices, "componentType": 5123},
            "values": {"bufferView": values},
        }
        accessor = {"componentType": 5126, "type": "VEC3", "count": count, "sparse": sparse, "min": low, "max": high}
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def write(self, name):
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.bytes).decode()
        self.json["buffers"] = [{"byteLength": len(self.bytes), "uri": uri}]
        with open(os.path.join(FOLDER, name), "w") as file:
            json.dump(self.json, file, indent=1)
            file.write("\n")


def turn(axis, degrees):
    """A quaternion, x y z w."""
    axis, half = np.array(axis, float), math.radians(degrees) / 2
    return [*(axis / np.linalg.norm(axis) * math.sin(half)), math.cos(half)]


def arm():
    """A square tube that five joints bend: two sets of influences, a scaled armature, a mesh node that is elsewhere."""
    file = Builder()
    rings, positions, joints, weights = 13, [], [], []
    for ring in range(rings):
        y = 4.0 * ring / (rings - 1)
        share = np.exp(-((y - np.arange(5.0)) ** 2))
        share /= share.sum()
        for x, z in [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]:
            positions.append([x, y, z])
            joints.append([0, 1, 2, 3, 4, 0, 0, 0])
            weights.append([*share, 0, 0, 0])
    indices = []
    for ring in range(rings - 1):
        for side in range(4):
            a, b = 4 * ring + side, 4 * ring + (side + 1) % 4
            indices += [a, a + 4, b, b, a + 4, b + 4]
    joints, weights = np.array(joints), np.array(weights)
    attributes = {
        "POSITION": file.accessor(positions, "VEC3", bounds=True),
        "JOINTS_0": file.accessor(joints[:, :4], "VEC4", np.uint8),
        "WEIGHTS_0": file.accessor(weights[:, :4], "VEC4"),
        "JOINTS_1": file.accessor(joints[:, 4:], "VEC4", np.uint16),
        "WEIGHTS_1": file.accessor(weights[:, 4:], "VEC4"),
    }
    primitive = {"attributes": attributes, "indices": file.accessor(indices, "SCALAR", np.uint16)}
    file.json["meshes"] = [{"primitives": [primitive]}]
    bind = [np.array([[1, 0, 0, 0], [0, 1, 0, -y], [0, 0, 1, 0], [0, 0, 0, 1]]).T for y in range(5)]
    file.json["skins"] = [{"joints": [2, 3, 4, 5, 6], "inverseBindMatrices": file.accessor(bind, "MAT4")}]
    up = [0, 1, 0]
    file.json["nodes"] = [
        {"mesh": 0, "skin": 0},
        {"children": [2], "scale": [1.5, 1.5, 1.5], "translation": [3, -1, 2], "rotation": turn([1, 2, 3], 40)},
        {"children": [3], "rotation": turn([0, 0, 1], 10)},
        *[{"children": [joint], "translation": up} for joint in (4, 5, 6)],
        {"translation": up},
    ]
    times = file.accessor([0.25, 1.0, 2.0], "SCALAR", bounds=True)
    keys = [turn([0, 0, 1], 0), turn([1, 0, 1], 70), turn([1, 0, 0], 200)]
    spline = [[0.1, 0.2, 0], up, [1, 0, 0.5], [0, -1, 1], [0, 1.3, 0.4], [0, 2, -1], [1, 1, 1], [0.3, 0.8, 0], up]
    stretch = [[1, 1, 1], [1, 1.25, 1], [0.8, 0.8, 0.8]]
    samplers = [
        {"input": times, "output": file.accessor(keys, "VEC4")},
        {"input": times, "output": file.accessor(spline, "VEC3"), "interpolation": "CUBICSPLINE"},
        {"input": times, "output": file.accessor(stretch, "VEC3"), "interpolation": "STEP"},
        {"input": times, "output": file.accessor(spin(), "VEC4"), "interpolation": "CUBICSPLINE"},
    ]
    targets = [(0, 3, "rotation"), (1, 4, "translation"), (2, 5, "scale"), (3, 6, "rotation")]
    channels = [{"sampler": s, "target": {"node": node, "path": path}} for s, node, path in targets]
    file.json["animations"] = [{"name": "bend", "samplers": samplers, "channels": channels}]
    file.json["scenes"] = [{"nodes": [0, 1]}]
    file.write("arm.gltf")


def spin():
    """Keys of a quaternion as a spline: tangent, value, tangent."""
    values = [turn([0, 1, 0], 0), turn([0, 1, 1], 50), turn([1, 1, 0], 120)]
    slope = [0.3, -0.2, 0.5, 0.1]
    return [row for value in values for row in (slope, value, slope)]


def face():
    """A grid with two morph targets, one of them sparse, at two nodes: one with weights of its own."""
    file = Builder()
    side = 6
    grid = np.array([[x, y, 0] for y in range(side) for x in range(side)], float)
    bump = np.exp(-((grid - 2.5) ** 2)[:, :2].sum(1) / 2)
    raised = np.stack([0.2 * bump, 0 * bump, 1.5 * bump], 1)
    corner = [(5, [0.5, -0.5, 1]), (11, [0.25, 0, 0.5]), (35, [1, 1, -1])]
    indices = []
    for y in range(side - 1):
        for x in range(side - 1):
            a = y * side + x
            indices += [a, a + 1, a + side, a + side, a + 1, a + side + 1]
    targets = [
        {"POSITION": file.accessor(raised, "VEC3", bounds=True)},
        {"POSITION": file.sparse(len(grid), [row for row, _ in corner], [value for _, value in corner])},
    ]
    primitive = {
        "attributes": {"POSITION": file.accessor(grid, "VEC3", bounds=True)},
        "indices": file.accessor(indices, "SCALAR", np.uint16),
        "targets": targets,
    }
    file.json["meshes"] = [{"primitives": [primitive], "weights": [0.5, 0.25]}]
    file.json["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [8, 0, 0], "weights": [-0.75, 1.0]}]
    times = file.accessor([0.5, 1.5, 2.0], "SCALAR", bounds=True)
    linear = [[0, 0], [1, -0.5], [0.25, 2]]
    spline = [[0, 1], [0.5, 0.5], [1, 0], [2, -1], [1, 0], [0, 1], [-1, 0], [0, 1], [1, 1]]
    samplers = [
        {"input": times, "output": file.accessor(linear, "SCALAR")},
        {"input": times, "output": file.accessor(spline, "SCALAR"), "interpolation": "CUBICSPLINE"},
    ]
    channel = lambda sampler, node: {"sampler": sampler, "target": {"node": node, "path": "weights"}}
    file.json["animations"] = [
        {"name": "both", "samplers": samplers, "channels": [channel(0, 0), channel(1, 1)]},
        {"name": "left", "samplers": samplers[:1], "channels": [channel(0, 0)]},
    ]
    file.json["scenes"] = [{"nodes": [0, 1]}]
    file.write("face.gltf")


class Reader:
    """A glTF file and its poses."""

    def __init__(self, path):
        raw = open(path, "rb").read()
        self.blob = None
        if raw[:4] == b"glTF":
            length = struct.unpack_from("<I", raw, 12)[0]
            self.json, self.blob = json.loads(raw[20 : 20 + length]), raw[28 + length :]
        else:
            self.json = json.loads(raw)

    def bytes_of(self, view):
        view = self.json["bufferViews"][view]
        uri = self.json["buffers"][view["buffer"]].get("uri")
        data = base64.b64decode(uri.split(",")[1]) if uri else self.blob
        start = view.get("byteOffset", 0)
        return data[start : start + view["byteLength"]], view.get("byteStride")

    def rows(self, holder, count, width, code):
        dtype = np.dtype(TYPES[code])
        data, stride = self.bytes_of(holder["bufferView"])
        offset, stride = holder.get("byteOffset", 0), stride or width * dtype.itemsize
        return np.array([np.frombuffer(data, dtype, width, offset + i * stride) for i in range(count)])

    def accessor(self, index):
        own = self.json["accessors"][index]
        width, code = WIDTHS[own["type"]], own["componentType"]
        values = np.zeros((own["count"], width), TYPES[code])
        if "bufferView" in own:
            values = self.rows(own, own["count"], width, code)
        if "sparse" in own:
            sparse = own["sparse"]
            at = self.rows(sparse["indices"], sparse["count"], 1, sparse["indices"]["componentType"])[:, 0]
            values[at] = self.rows(sparse["values"], sparse["count"], width, code)
        values = values.astype(float)
        if own.get("normalized"):
            values = np.maximum(values / np.iinfo(TYPES[code]).max, -1)
        return values

    def value(self, sampler, time, count):
        """The numbers of a sampler at a time; `count` numbers to a key. Quaternions have count -4."""
        keys = self.accessor(sampler["input"])[:, 0]
        kind, size = sampler.get("interpolation", "LINEAR"), abs(count)
        values = self.accessor(sampler["output"]).reshape(len(keys), -1, size)
        middle = values.shape[1] // 2
        if time <= keys[0]:
            return values[0, middle]
        if time >= keys[-1]:
            return values[-1, middle]
        k = int(np.searchsorted(keys, time, "right")) - 1
        span = keys[k + 1] - keys[k]
        s = (time - keys[k]) / span
        a, b = values[k, middle], values[k + 1, middle]
        if kind == "STEP":
            return a
        if kind == "CUBICSPLINE":
            c, d = values[k, 2] * span, values[k + 1, 0] * span
            bernstein = [a, a + c / 3, b - d / 3, b]
            return sum(math.comb(3, i) * s**i * (1 - s) ** (3 - i) * p for i, p in enumerate(bernstein))
        if count == -4:
            cosine = float(a @ b)
            b, angle = b * (-1 if cosine < 0 else 1), math.acos(min(abs(cosine), 1))
            if angle > 1e-6:
                return (math.sin((1 - s) * angle) * a + math.sin(s * angle) * b) / math.sin(angle)
        return a + s * (b - a)

    def pose(self, animation, time):
        """Triangles in world space, n x 3 x 3."""
        nodes = [dict(node) for node in self.json["nodes"]]
        for channel in self.json["animations"][animation]["channels"] if time is not None else []:
            sampler = self.json["animations"][animation]["samplers"][channel["sampler"]]
            node, path = nodes[channel["target"]["node"]], channel["target"]["path"]
            count = {"translation": 3, "scale": 3, "rotation": -4}.get(path)
            if path == "weights":
                count = len(self.json["meshes"][node["mesh"]]["primitives"][0]["targets"])
            node[path] = self.value(sampler, time, count)
        world = [None] * len(nodes)

        def descend(index, above):
            world[index] = above @ local(nodes[index])
            for child in nodes[index].get("children", []):
                descend(child, world[index])

        for root in self.json["scenes"][self.json.get("scene", 0)]["nodes"]:
            descend(root, np.eye(4))
        triangles = []
        for node, matrix in zip(nodes, world):
            if "mesh" not in node or matrix is None:
                continue
            mesh = self.json["meshes"][node["mesh"]]
            for primitive in mesh["primitives"]:
                positions = self.accessor(primitive["attributes"]["POSITION"])
                targets = primitive.get("targets", [])
                weights = node.get("weights", mesh.get("weights", [0] * len(targets)))
                for target, weight in zip(targets, weights):
                    positions = positions + weight * self.accessor(target["POSITION"])
                positions = np.concatenate([positions, np.ones((len(positions), 1))], 1)
                if "skin" in node:
                    positions = self.skinned(primitive["attributes"], positions, node["skin"], world)
                else:
                    positions = positions @ matrix.T
                order = range(len(positions))
                if "indices" in primitive:
                    order = self.accessor(primitive["indices"])[:, 0].astype(int)
                triangles.append(positions[list(order), :3].reshape(-1, 3, 3))
        return np.concatenate(triangles)

    def skinned(self, attributes, positions, skin, world):
        skin = self.json["skins"][skin]
        inverse = self.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        matrices = np.array([world[joint] @ inverse[i] for i, joint in enumerate(skin["joints"])])
        blended, total = np.zeros((len(positions), 4, 4)), np.zeros(len(positions))
        number = 0
        while f"JOINTS_{number}" in attributes:
            joints = self.accessor(attributes[f"JOINTS_{number}"]).astype(int)
            weights = self.accessor(attributes[f"WEIGHTS_{number}"])
            for corner in range(4):
                blended += weights[:, corner, None, None] * matrices[joints[:, corner]]
                total += weights[:, corner]
            number += 1
        return np.einsum("vij,vj->vi", blended / total[:, None, None], positions)


def local(node):
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), float) / np.linalg.norm(node.get("rotation", [1]))
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(rotation) * np.array(node.get("scale", [1, 1, 1]), float)
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def blender(path, animation, time):
    """As Reader.pose, by Blender."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path, merge_vertices=False)
    name = Reader(path).json["animations"][animation]["name"]
    for thing in [*bpy.data.objects, *(mesh.shape_keys for mesh in bpy.data.meshes if mesh.shape_keys)]:
        data = thing.animation_data
        if data is None:
            continue
        strips = [strip for track in data.nla_tracks if track.name == name for strip in track.strips]
        for track in data.nla_tracks:
            track.mute = True
        # A strip would begin at frame 1, whenever its first key is.
        data.action = strips[0].action if strips else None
        if strips:
            data.action_slot = strips[0].action_slot
    # The interface limits weights, from 0 to 1.
    for shapes in bpy.data.shape_keys:
        for block in shapes.key_blocks:
            block.slider_min, block.slider_max = -10, 10
    scene = bpy.context.scene
    frame = time * scene.render.fps / scene.render.fps_base
    scene.frame_set(math.floor(frame), subframe=frame - math.floor(frame))
    graph, triangles = bpy.context.evaluated_depsgraph_get(), []
    meshes = [thing for thing in scene.objects if thing.type == "MESH" and not thing.name.startswith("Icosphere")]
    for thing in meshes:
        evaluated = thing.evaluated_get(graph)
        mesh = evaluated.to_mesh()
        points = [evaluated.matrix_world @ vertex.co for vertex in mesh.vertices]
        triangles += [[points[i] for i in polygon.vertices] for polygon in mesh.polygons]
    # Blender's z is up.
    return np.array([[[p.x, p.z, -p.y] for p in corners] for corners in triangles])


def main():
    arm()
    face()
    # File, animation, time, whether keys are at that time, and every how many triangles are kept.
    cases = [("arm.gltf", 0, time, time in (0.0, 0.25, 1.0, 2.0, 3.0), 3) for time in (0.0, 0.25, 0.7, 1.0, 1.4, 2.0, 3.0)]
    cases += [("face.gltf", 0, time, time in (0.5, 1.5, 2.0), 1) for time in (0.2, 0.5, 0.9, 1.5, 1.7, 2.0)]
    fox = sys.argv[1] if len(sys.argv) > 1 else None
    if fox:
        cases += [("Fox.glb", animation, time, True, 32) for animation, time in ((0, 1.25), (1, 0.0), (1, 0.375), (2, 0.5))]
        cases += [("Fox.glb", 2, time, False, 32) for time in (0.0, 0.3333, 1.0, 5.0)]
    expected = []
    for name, animation, time, at_keys, step in cases:
        path = fox if name == "Fox.glb" else os.path.join(FOLDER, name)
        triangles = Reader(path).pose(animation, time)
        size = np.linalg.norm(np.ptp(triangles.reshape(-1, 3), axis=0))
        if at_keys:
            error = np.abs(blender(path, animation, time) - triangles).max() / size
            print(f"{name} {animation} {time}: Blender differs by {error:.1e} of the size")
            assert error < TOLERANCE
        kept = [[[float(f"{x:.9g}") for x in corner] for corner in corners] for corners in triangles[::step]]
        case = {"file": name, "animation": animation, "time": time, "step": step, "triangles": len(triangles)}
        expected.append({**case, "kept": kept})
    with open(os.path.join(FOLDER, "expected.json"), "w") as file:
        lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in expected)
        file.write(f"[\n{lines}\n]\n")


main()

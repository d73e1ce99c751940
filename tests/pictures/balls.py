"""Balls for pictures: one as a file of its own, for `kiln preview --object`, or several inside a scene, for path tracing.

    python3 balls.py ball.glb                                   a white ball of radius 1 about the origin
    python3 balls.py in.glb out.glb 0.4 1,1.2,0 -3,1.2,1 …      a scene with balls of that radius at these places
"""

import json
import math
import struct
import sys

PARALLELS, MERIDIANS = 32, 64


def sphere():
    """Corners, which are normals too, and triangles, seen from outside."""
    points = []
    for row in range(PARALLELS + 1):
        polar = math.pi * row / PARALLELS
        for column in range(MERIDIANS + 1):
            turn = 2 * math.pi * column / MERIDIANS
            points.append((math.sin(polar) * math.cos(turn), math.cos(polar), -math.sin(polar) * math.sin(turn)))
    triangles = []
    for row in range(PARALLELS):
        for column in range(MERIDIANS):
            here = row * (MERIDIANS + 1) + column
            below = here + MERIDIANS + 1
            triangles += [(here, below, here + 1), (here + 1, below, below + 1)]
    return points, triangles


def read(path):
    data = open(path, "rb").read()
    length = struct.unpack_from("<I", data, 12)[0]
    start = 20 + length + 8
    return json.loads(data[20 : 20 + length]), bytearray(data[start:])


def write(path, scene, binary):
    scene["buffers"] = [{"byteLength": len(binary)}]
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    head = struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(binary))
    with open(path, "wb") as file:
        file.write(head + struct.pack("<II", len(text), 0x4E4F534A) + text)
        file.write(struct.pack("<II", len(binary), 0x004E4942) + binary)


def add_balls(scene, binary, radius, places):
    points, triangles = sphere()
    binary += b"\0" * (-len(binary) % 4)

    def accessor(data, component, count, kind, **more):
        scene.setdefault("bufferViews", []).append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary.extend(data)
        view = len(scene["bufferViews"]) - 1
        accessor = {"bufferView": view, "componentType": component, "count": count, "type": kind}
        scene.setdefault("accessors", []).append({**accessor, **more})
        return len(scene["accessors"]) - 1

    floats = b"".join(struct.pack("<3f", *point) for point in points)
    corners = accessor(floats, 5126, len(points), "VEC3", min=[-1, -1, -1], max=[1, 1, 1])
    normals = accessor(floats, 5126, len(points), "VEC3")
    numbers = b"".join(struct.pack("<3I", *triangle) for triangle in triangles)
    indices = accessor(numbers, 5125, 3 * len(triangles), "SCALAR")
    colour = {"baseColorFactor": [0.8, 0.8, 0.8, 1], "metallicFactor": 0, "roughnessFactor": 1}
    scene.setdefault("materials", []).append({"name": "ball", "pbrMetallicRoughness": colour})
    primitive = {"attributes": {"POSITION": corners, "NORMAL": normals}, "indices": indices}
    primitive["material"] = len(scene["materials"]) - 1
    scene.setdefault("meshes", []).append({"name": "ball", "primitives": [primitive]})
    for number, place in enumerate(places, 1):
        node = {"name": f"ball {number}", "mesh": len(scene["meshes"]) - 1, "translation": place, "scale": [radius] * 3}
        scene.setdefault("nodes", []).append(node)
        scene["scenes"][0].setdefault("nodes", []).append(len(scene["nodes"]) - 1)


def main(arguments):
    if len(arguments) == 1:
        scene, binary = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{}]}, bytearray()
        add_balls(scene, binary, 1, [[0, 0, 0]])
        write(arguments[0], scene, binary)
    elif len(arguments) > 3:
        scene, binary = read(arguments[0])
        places = [[float(number) for number in place.split(",")] for place in arguments[3:]]
        add_balls(scene, binary, float(arguments[2]), places)
        write(arguments[1], scene, binary)
    else:
        sys.exit(__doc__)


main(sys.argv[1:])

"""Millions of rays a second by Embree, on one thread: FOLDER ROUNDS QUERY..., one query for each file rays-N."""

import sys
import time

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

folder, rounds, queries = sys.argv[1], int(sys.argv[2]), sys.argv[3:]
scene = rtcore_scene.EmbreeScene()
TriangleMesh(scene, np.fromfile(f"{folder}/triangles", np.float32).reshape(-1, 3, 3))
for index, query in enumerate(queries):
    rays = np.fromfile(f"{folder}/rays-{index}", np.float32).reshape(-1, 7)
    starts, directions, ends = (np.ascontiguousarray(part) for part in (rays[:, :3], rays[:, 3:6], rays[:, 6]))
    best = 0.0
    for _ in range(rounds):
        # Distances are written into the array that is given.
        far, started = ends.copy(), time.perf_counter()
        scene.run(starts, directions, dists=far, query=query)
        best = max(best, len(rays) / (time.perf_counter() - started) / 1e6)
    print(f"{best:.2f}")
